"""A depth map whose depths belong to points anywhere within their pixels, as after resampling.

A scanner that outputs a smaller or rectified map selects one of several measured points for
each pixel. The point is right, but on a steep surface its depth differs from the depth at the
centre of the pixel. The positions are fixed, because they belong to the raster and not to a
shot.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..finish import PATCH_M, uneven
from .maps import DepthMap

# as a share of its depth, that a surface may rise from one pixel to the next but one
STEEPEST = 0.02
_SEED = 15  # of the raster; any number would do


def on_raster(
    depth: DepthMap, raster_px: float, *, unevenness: float = 0.0, focal_px: float
) -> DepthMap:
    """The depth at a point `raster_px` (one sigma along each axis) from the pixel's centre.

    With an `unevenness` above 0 the points of some patches are farther from their centres, and
    those of others nearer (`finish.uneven`); the mean square stays the same.

    The surface is the plane, in inverse depth, through both neighbours of a pixel along each axis;
    beside steps and holes it is flat. `sigma_m` holds what the place does to the depth.
    """
    shape = depth.depth_m.shape
    away_px = np.full(shape, raster_px)
    if unevenness and np.isfinite(depth.depth_m).any():
        patch_px = focal_px * PATCH_M / float(np.nanmedian(depth.depth_m))
        away_px = uneven(away_px, unevenness, patch_px=patch_px, seed=_SEED)
    widest = np.sqrt(3) * away_px  # places are even over a square
    right, down = widest * np.random.default_rng(_SEED).uniform(-1, 1, (2, *shape))
    inverse = 1 / depth.depth_m.astype(np.float64)
    along, across = _slope(inverse, 1), _slope(inverse, 0)
    depth_m = 1 / (inverse + right * along + down * across)
    spread_m = raster_px * np.hypot(along, across) / inverse**2
    return replace(
        depth,
        depth_m=depth_m.astype(np.float32),
        sigma_m=np.hypot(depth.sigma_m, spread_m).astype(np.float32),
    )


def _slope(inverse: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Change of inverse depth per pixel; 0 where a neighbour is missing or another surface."""
    slope = np.zeros(inverse.shape)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    rise = (np.roll(inverse, -1, axis) - np.roll(inverse, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        same = np.abs(rise) < STEEPEST * inverse[inner]  # NaN is not <
    slope[inner] = np.where(same, 0.5 * rise, 0.0)
    return slope
