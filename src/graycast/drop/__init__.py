"""Parts fall into the bin until they rest: `Scene -> Layout`."""

from .decomposition import cache_folder, convex_hulls
from .settle import DropLimits, drop, flaws

__all__ = ["DropLimits", "cache_folder", "convex_hulls", "drop", "flaws"]
