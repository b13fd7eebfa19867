"""From a stack of pictures to projector positions to depth, with a reason where there is none.

maps           inputs and results: settings, maps, and the reasons of pixels without depth
plan           which frames are the bits and the phases of each axis
bits, phases   the values of bits and of phases; phases that disagree
positions      all frames into positions: where a pixel is decoded or gets its reason
settling       ambiguous periods, which neighbours resolve
visibility     pixels that a nearer surface must hide
separation     direct and global light
meeting        where rays of the camera meet planes of the projector, compiled
field          pixels that the projector's picture cannot reach
triangulation  from positions to depth
outliers, median, filters   what a device removes from its depth
"""

from .filters import filter_depth
from .maps import (
    REASON_COLOR,
    CodeMap,
    DecodeSpec,
    DepthMap,
    FilterSpec,
    Levels,
    Mark,
    Reason,
    levels_of,
    little_depth_note,
    pooled_shares,
    reason_counts,
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
    "epipolar_residual_px",
    "filter_depth",
    "levels_of",
    "little_depth_note",
    "meet_planes",
    "off_the_line",
    "pooled_shares",
    "reason_counts",
    "reason_shares",
    "separate",
    "triangulate",
    "triangulation_axis",
]
