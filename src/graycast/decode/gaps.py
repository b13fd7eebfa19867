"""Depth in short gaps along the projector's lines, between two ends of one surface.

A scanner reconstructs along the lines that it projects, and a pixel that speckle or dirt darkens
lies between others whose line is known. Along a line there is no shadow of an edge: shadows lie
beside their edges in the direction of the baseline. So a short gap whose ends belong to one surface
is bridged by the straight line in inverse depth, which is exact on a plane.

Five real scans of a Photoneo PhoXi look as if it did so: on dim walls, neighbours along the lines
often have nearly the same error and otherwise unrelated ones, and single missing pixels are rare
where noise alone would strew them (docs/twin.md).

Leaves out: lens distortion, and what the surface does within the gap.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int

from ..rig import Rig
from .maps import DepthMap, Reason
from .triangulation import triangulation_axis

STEEPEST_TAN = math.tan(math.radians(60))  # a steeper way between the ends may be a step


def with_gaps_filled(depth: DepthMap, rig: Rig, *, most_px: int) -> DepthMap:
    """The same depth, with depth in gaps of at most `most_px` pixels along the projector's lines.

    The lines are taken as the camera's columns (its rows, where the baseline runs down). A gap at
    the border of the picture has one end and stays. `sigma_m` of a filled pixel is that of the
    straight line between both ends.
    """
    column = triangulation_axis(rig) == "column"
    along = (lambda m: m) if column else (lambda m: m.T)
    known = np.isfinite(along(depth.depth_m))
    row, x, first, last = _gaps(known, most_px)
    inverse = 1 / along(depth.depth_m).astype(np.float64)
    sigma = along(depth.sigma_m) * inverse**2
    ends = inverse[first, x], inverse[last, x]
    focal_px = rig.camera.fy_px if column else rig.camera.fx_px
    rise = np.abs(1 / ends[1] - 1 / ends[0])  # m of depth, over so many m across the line of sight
    flat = rise <= STEEPEST_TAN * (last - first) / focal_px / np.maximum(*ends)
    row, x, first, last = row[flat], x[flat], first[flat], last[flat]
    share = (row - first) / (last - first)
    filled = (1 - share) * inverse[first, x] + share * inverse[last, x]
    spread = np.hypot((1 - share) * sigma[first, x], share * sigma[last, x])

    depth_m, sigma_m, reason = (m.copy() for m in (depth.depth_m, depth.sigma_m, depth.reason))
    along(depth_m)[row, x] = 1 / filled
    along(sigma_m)[row, x] = spread / filled**2
    along(reason)[row, x] = Reason.DECODED
    return replace(depth, depth_m=depth_m, sigma_m=sigma_m, reason=reason)


def _gaps(known: Bool[np.ndarray, "h w"], most_px: int) -> Int[np.ndarray, "4 n"]:
    """Row and column of each pixel in a short gap of its column, and the rows of both its ends."""
    height = len(known)
    row = np.arange(height)[:, None]
    before = np.maximum.accumulate(np.where(known, row, -1), axis=0)
    after = np.minimum.accumulate(np.where(known, row, height)[::-1], axis=0)[::-1]
    short = ~known & (before >= 0) & (after < height) & (after - before - 1 <= most_px)
    y, x = np.nonzero(short)
    return np.stack([y, x, before[y, x], after[y, x]])
