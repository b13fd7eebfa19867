"""Detection of pixels that are off the surrounding surface, and the depth of that surface."""

import numba
import numpy as np

from ...base.kernels import kernel
from ...base.robust import MAD_SIGMA
from .median import median

LEAST = 4  # A median needs this many values.
SUPPORT_PX = 3  # With this many of 24 neighbours near its depth, a pixel is no outlier.
WHOLE_PX = 20  # With this many of 24 neighbours near their median, a surface has no edge.


@kernel(parallel=True)
def find_outliers(inverse, noise, sigmas, share, margin, repair, removed, surface):
    """Mark outliers in maps of inverse depth, which have a border of NaN, in `removed`.

    Args:
        repair: whether outliers inside a surface without an edge are repaired instead of marked.
        surface: output, the surface's inverse depth and standard deviation at repaired pixels.
    """
    h, w = removed.shape
    for row in numba.prange(h):
        for column in range(w):
            y, x = row + margin, column + margin
            # Almost every pixel is near the line of two opposite neighbours; this test is fast.
            if np.isnan(inverse[y, x]):
                continue
            if not _in_line(inverse, noise, y, x, 0.5 * sigmas, 0.5 * share):
                outlies, middle, around = _outlies(inverse, noise, y, x, sigmas, share)
                if outlies and repair and around > 0:
                    surface[0, row, column], surface[1, row, column] = middle, around
                else:
                    removed[row, column] |= outlies


@kernel()
def _in_line(inverse, noise, y, x, sigmas, share):
    middle = np.float64(inverse[y, x])
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a, b = inverse[y - down, x - right], inverse[y + down, x + right]
        first, second = noise[y - down, x - right], noise[y + down, x + right]
        off = middle - 0.5 * (a + b)
        variance = noise[y, x] * noise[y, x] + 0.25 * (first * first + second * second)
        if off * off <= max(sigmas * sigmas * variance, share * share * middle * middle):
            return True
    return False


@kernel()
def _outlies(inverse, noise, y, x, sigmas, share):
    """Compare a pixel with the median of 5 x 5 pixels, corrected for the median slopes.

    Return whether the pixel is an outlier, the median, and the scatter (0 next to an edge).
    """
    window = inverse[y - 2 : y + 3, x - 2 : x + 3].astype(np.float64)
    middle = window[2, 2]
    window[2, 2] = np.nan
    slope_x = median((window[:, 1:] - window[:, :-1]).ravel(), LEAST)
    slope_y = median((window[1:] - window[:-1]).ravel(), LEAST)
    if np.isnan(slope_x) or np.isnan(slope_y):
        return False, 0.0, 0.0  # Too few neighbours to decide; `island_px` removes such pixels.
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            window[dy + 2, dx + 2] -= slope_y * dy + slope_x * dx
    level = window.ravel()
    usual = median(level, LEAST)
    deviation = abs(middle - usual)
    local = MAD_SIGMA * median(np.abs(level - usual), LEAST)
    limit = max(sigmas * max(noise[y, x], local), share * middle)
    if not deviation > limit or (np.abs(level - middle) < 0.5 * deviation).sum() >= SUPPORT_PX:
        return False, 0.0, 0.0
    whole = (np.abs(level - usual) <= limit).sum() >= WHOLE_PX
    return True, usual, local if whole else 0.0
