"""Fusion of several views of a scene into one cloud, and the surface that each view adds."""

from .adding import best_order
from .fuse import HIDDEN, OUTSIDE, THROUGH, Fused, FusedCloud, fuse
from .merging import described, merge, merged_ply
from .stored_views import read_view
from .view import MeasuredView

__all__ = [
    "HIDDEN",
    "OUTSIDE",
    "THROUGH",
    "Fused",
    "FusedCloud",
    "MeasuredView",
    "best_order",
    "described",
    "fuse",
    "merge",
    "merged_ply",
    "read_view",
]
