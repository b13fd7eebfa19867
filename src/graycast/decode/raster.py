"""A depth map whose depths belong to points anywhere within their pixels, as after resampling.

A scanner that outputs a smaller or rectified map selects one of several measured points for
each pixel. The point is right, but on a steep surface its depth differs from the depth at the
centre of the pixel. If the scanner instead takes the mean of the points in a window, weighted by
the light of each, the mean lies on the brighter side of the window. Windows of neighbouring pixels
overlap, so their places are related: places along x are alike in neighbouring rows, and change
their sign within a row, as the gradient of a random field does. Five real scans of a Photoneo PhoXi
show this on slopes of both directions (docs/twin.md).

The positions are fixed, because they belong to the raster and not to a shot.

Leaves out: lines of a projector that lies above or below the camera, which are rows; that light
changes from shot to shot, as speckle does. In the real scans, half of this noise or more is another
one in every scan.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ..finish import PATCH_M, uneven
from .maps import DepthMap

# as a share of its depth, that a surface may rise from one pixel to the next but one
STEEPEST = 0.02
_SEED = 15  # of the raster; any number would do
_FINE = 2  # spots of light within a pixel, along either axis


def on_raster(
    depth: DepthMap,
    raster_px: float,
    *,
    window_px: float = 0.0,
    window_share: float = 1.0,
    limit_m: float = math.inf,
    unevenness: float = 0.0,
    line_unevenness: float = 0.0,
    light_contrast: Float[np.ndarray, "h w"] | float = 1.0,
    focal_px: float,
) -> DepthMap:
    """The depth at a point `raster_px` (one sigma along each axis) from the pixel's centre.

    `window_px` and `window_share` are those of `places`. `light_contrast` is how uneven the light
    in a pixel's window is, as a share of that on a black surface: where a surface has an even
    light, as white paper has, the mean of the window's points lies nearer to the centre by it.

    With a `limit_m`, the error of depth on a surface that rises by s per pixel is not
    `raster_px s`, but `1 / sqrt(1 / (raster_px s)^2 + 1 / limit_m^2)`. So it is unchanged on gentle
    slopes and ends at `limit_m` on the steepest, as in a scanner that leaves points out of its
    window whose depth is too different.

    With an `unevenness` above 0 the points of some patches are farther from their centres, and
    those of others nearer (`finish.uneven`); the mean square stays the same.

    With a `line_unevenness` above 0 they differ from pixel to pixel, too, but hardly between the
    pixels of a column that touch (`line_amplitude`).

    The surface is the plane, in inverse depth, through both neighbours of a pixel along each axis;
    beside steps and holes it is flat. `sigma_m` holds what the place does to the depth.
    """
    shape = depth.depth_m.shape
    away_px = np.full(shape, raster_px)
    if unevenness and np.isfinite(depth.depth_m).any():
        patch_px = focal_px * PATCH_M / float(np.nanmedian(depth.depth_m))
        away_px = uneven(away_px, unevenness, patch_px=patch_px, seed=_SEED)
    if line_unevenness:
        away_px = away_px * line_amplitude(shape, line_unevenness)
    right, down = places(shape, window_px, window_share) * away_px
    inverse = 1 / depth.depth_m.astype(np.float64)
    along, across = _slope(inverse, 1), _slope(inverse, 0)
    spread_m = raster_px * np.hypot(along, across) / inverse**2
    left = light_contrast / np.hypot(1, spread_m / limit_m)
    depth_m = 1 / (inverse + left * (right * along + down * across))
    return replace(
        depth,
        depth_m=depth_m.astype(np.float32),
        sigma_m=np.hypot(depth.sigma_m, left * spread_m).astype(np.float32),
    )


def places(
    shape: tuple[int, int], window_px: float, window_share: float = 1.0
) -> Float[np.ndarray, "2 h w"]:
    """Where each pixel's point lies, to the right and downwards, with a variance of one.

    Without a window, places are independent and even over a square. With one of the standard
    deviation w, a place is the mean of `r` weighted by `exp(-r^2 / 2 w^2)` and by light that is
    independent from spot to spot. To first order in the light's contrast this is the gradient of
    a Gaussian convolved with white noise. Two pixels at a distance r have the correlation
    `exp(-r^2 / 4 w^2)` across the direction of the place, and along it `1 - r^2 / 2 w^2` times as
    much. Of the variance, `window_share` is the window's, and the rest is independent: a scanner
    that takes the mean of few points has both.
    """
    rng = np.random.default_rng(_SEED)
    alone = np.sqrt(3) * rng.uniform(-1, 1, (2, *shape))
    if not window_px:
        return alone
    light = rng.standard_normal((_FINE * shape[0], _FINE * shape[1]), dtype=np.float32)
    sigma = _FINE * window_px
    middle = np.zeros(2 * int(8 * sigma) + 3)
    middle[len(middle) // 2] = 1.0
    norm = np.sqrt(np.prod([(ndimage.gaussian_filter1d(middle, sigma, order=order) ** 2).sum()
                            for order in (0, 1)]))  # fmt: skip
    right, down = (
        ndimage.gaussian_filter(light, sigma, order=order, mode="wrap")[::_FINE, ::_FINE] / norm
        for order in ((0, 1), (1, 0))
    )
    shared = np.stack([right, down])
    return np.sqrt(window_share) * shared + np.sqrt(1 - window_share) * alone


def line_amplitude(shape: tuple[int, int], unevenness: float) -> Float[np.ndarray, "h w"]:
    """A factor of each pixel's place, by a log-normal law whose mean square is 1.

    Its logarithm has the standard deviation `unevenness`. It is independent between columns; along
    a column, two pixels at a distance r have the correlation `exp(-r^2 / 4)`. In five real scans,
    the sizes of errors are alike in this way: what makes them lies along the projector's lines.
    """
    rng = np.random.default_rng(_SEED + 1)
    middle = np.zeros(2 * 8 + 1)
    middle[len(middle) // 2] = 1.0
    norm = np.sqrt((ndimage.gaussian_filter1d(middle, 1.0) ** 2).sum())
    field = ndimage.gaussian_filter1d(rng.standard_normal(shape), 1.0, axis=0, mode="wrap") / norm
    return np.exp(unevenness * field - unevenness**2)


def _slope(inverse: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Change of inverse depth per pixel; 0 where a neighbour is missing or another surface."""
    slope = np.zeros(inverse.shape)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    rise = (np.roll(inverse, -1, axis) - np.roll(inverse, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        same = np.abs(rise) < STEEPEST * inverse[inner]  # NaN is not <
    slope[inner] = np.where(same, 0.5 * rise, 0.0)
    return slope
