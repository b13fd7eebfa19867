"""Parts fall into the bin until they rest: `Scene -> Layout`."""

from .decomposition import Decomposition, OnStage, cache_folder, convex_hulls
from .lift import Hold, Lift, lift
from .settle import DropLimits, drop, flaws, hull_notes, prepare

__all__ = [
    "Decomposition",
    "DropLimits",
    "Hold",
    "Lift",
    "OnStage",
    "cache_folder",
    "convex_hulls",
    "drop",
    "flaws",
    "hull_notes",
    "lift",
    "prepare",
]
