"""From a stack of pictures to projector positions to depth, with a reason where there is none."""

from .displaced import with_bends, with_displacement, with_place_sigma
from .filters import FilterSpec, depth_steps, filter_depth
from .maps import (
    REASON_COLOR,
    CodeMap,
    DecodeSpec,
    DepthMap,
    Levels,
    Mark,
    Reason,
    levels_of,
    mean_shares,
    reason_shares,
)
from .positions import decode
from .separation import separate
from .triangulation import (
    epipolar_residual_px,
    meet_planes,
    off_the_line,
    triangulate,
    triangulation_axis,
)

__all__ = [
    "REASON_COLOR",
    "CodeMap",
    "DecodeSpec",
    "DepthMap",
    "FilterSpec",
    "Levels",
    "Mark",
    "Reason",
    "decode",
    "depth_steps",
    "epipolar_residual_px",
    "filter_depth",
    "levels_of",
    "mean_shares",
    "meet_planes",
    "off_the_line",
    "reason_shares",
    "separate",
    "triangulate",
    "triangulation_axis",
    "with_bends",
    "with_displacement",
    "with_place_sigma",
]
