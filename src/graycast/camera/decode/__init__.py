"""From a stack of pictures to projector positions and depth, or a reason for missing depth.

maps           inputs and results: settings and maps
reasons        reasons of pixels without depth, and the functions that set them
plan           the assignment of frames to bits and phases of each axis
bits, phases   the values of bits and of phases; phases that disagree
positions      from all frames to positions; each pixel is decoded or gets a reason
settling       ambiguous periods, which neighbours resolve
visibility     pixels that a nearer surface must hide
separation     direct and global light
moving_points  points of a moving scene and their light in all pictures
motion_estimate  the estimate of a steady motion
taken_back     pictures of a moving scene, taken back to one time
meeting        intersections of camera rays and projector planes, compiled
field          pixels that the projector's picture cannot reach
triangulation  from positions to depth
evidence       the probability that a depth is wrong, from all frames and neighbours
union_find     connected surfaces of pixels
outliers, median, filters   filters that remove or smooth depth, as devices do
"""

from .evidence import without_doubt, without_doubtful_positions
from .filters import filter_depth
from .maps import (
    WRONG_M,
    WRONG_SIGMAS,
    CodeMap,
    DecodeSpec,
    DepthMap,
    FilterSpec,
    Levels,
    Mark,
    levels_of,
)
from .motion_estimate import steady_motion, steady_transforms
from .positions import decode
from .reasons import (
    POSITIONED,
    REASON_COLOR,
    Reason,
    little_depth_note,
    pooled_shares,
    reason_counts,
    reason_shares,
)
from .separation import separate
from .taken_back import take_back
from .triangulation import (
    epipolar_residual_px,
    meet_planes,
    off_the_line,
    triangulate,
    triangulation_axis,
)

__all__ = [
    "POSITIONED",
    "REASON_COLOR",
    "WRONG_M",
    "WRONG_SIGMAS",
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
    "steady_motion",
    "steady_transforms",
    "take_back",
    "triangulate",
    "triangulation_axis",
    "without_doubt",
    "without_doubtful_positions",
]
