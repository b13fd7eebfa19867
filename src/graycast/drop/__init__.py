"""Parts fall into the bin until they rest: `Scene -> Layout`."""

from .decomposition import OnStage, cache_folder, convex_hulls
from .settle import DropLimits, drop, flaws, prepare

__all__ = ["DropLimits", "OnStage", "cache_folder", "convex_hulls", "drop", "flaws", "prepare"]
