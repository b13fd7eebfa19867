"""Fit of the pose, colours and light of a real bin to scans of the empty bin."""

from .bin_views import empty_view, read_views
from .fitting import (
    azimuth_of,
    fit_pose,
    read_frames,
    shape_of,
    summary,
    with_bend,
    with_look,
    write_fit,
)

__all__ = [
    "azimuth_of",
    "empty_view",
    "fit_pose",
    "read_frames",
    "read_views",
    "shape_of",
    "summary",
    "with_bend",
    "with_look",
    "write_fit",
]
