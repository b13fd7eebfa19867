"""Depth of a stack without points off their epipolar line, and with filters on request."""

import numpy as np
from jaxtyping import Float

from ...rig.pair import Rig
from ..decode import CodeMap, DepthMap, FilterSpec, Reason, filter_depth, off_the_line
from ..sigma import bend_m, with_depth_term

# Without a stated limit, the limit is this many times the median residual, and at least 2 px,
# because a calibration has larger errors than usual in some places.
EPIPOLAR_MEDIANS, EPIPOLAR_PX = 5.0, 2.0


def epipolar_limit_px(
    stated_px: float | None, residual_px: Float[np.ndarray, "h w"] | None
) -> float:
    """Return the largest accepted epipolar residual; infinite without a limit."""
    if stated_px is not None or residual_px is None:
        return stated_px or np.inf
    known = np.abs(residual_px[np.isfinite(residual_px)])
    median_px = float(np.median(known)) if known.size else 0.0
    return max(EPIPOLAR_MEDIANS * median_px, EPIPOLAR_PX)


def believed_depth(
    codes: CodeMap,
    first: DepthMap,
    residual_px: Float[np.ndarray, "h w"] | None,
    rig: Rig,
    *,
    stated_px: float | None,
    filters: FilterSpec | None,
) -> DepthMap:
    """Return the depth without outliers, filtered on request, with the term `bend` in its sigma."""
    limit_px = epipolar_limit_px(stated_px, residual_px)
    depth = less_outliers(codes, first, residual_px, rig, limit_px)
    if filters is not None:
        depth = filter_depth(depth, filters, rig)
    return with_depth_term(depth, bend_m(depth))


def less_outliers(
    codes: CodeMap,
    depth: DepthMap,
    residual_px: Float[np.ndarray, "h w"] | None,
    rig: Rig,
    limit_px: float,
) -> DepthMap:
    """Remove the pixels that are farther from their epipolar line than the limit plus noise."""
    if residual_px is None or not np.isfinite(limit_px):
        return depth
    far = off_the_line(codes, residual_px, rig, limit_px=limit_px)
    return depth.without(far, Reason.OUTLIER)
