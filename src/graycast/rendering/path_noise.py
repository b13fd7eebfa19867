"""Error of a pixel's patterns from its finite number of light paths, estimated from these paths.

All patterns of a stack share their paths, so the error is in the positions at which these paths met
the projector's picture. The mean position of a pixel's direct light differs from the position that
the pixel's centre sees, by the scatter of paths over the pixel and by the projector's square
pixels. This residual is known, because the surface at the centre is known; its mean square over
neighbours is the variance. It is divided by the variance of a single path, which is the pixel's
footprint in the projector's picture plus a projector pixel, so that neighbours on other slopes
count as well. Pixels next to an edge or a shadow do not count: more paths would not remove their
residual.

Indirect light comes from anywhere in the picture. Its variance is the sum of squares over paths.

Leaves out: pixels that see two surfaces in a ratio that depends on few paths (they get the value of
their neighbours); the part of indirect light that all paths have in common, which shifts decoded
positions even in the limit of many paths.
"""

import math
from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Bool, Float

from ..rig.pattern import AXES, Axis
from .radiance import PathNoise

WINDOW_PX = 9  # Squared errors are averaged over a square with this side (81 values).
MOST_BEND = 1.0  # Three neighbours have no edge if positions bend by fewer sigmas of a path.


def path_noise(
    places_px: Mapping[Axis, tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]],
    straight: Float[np.ndarray, "h w"],
    stray2: Mapping[Axis, Float[np.ndarray, "h w"]],
    *,
    samples: int,
) -> PathNoise:
    """Return standard deviations from sums over paths; 0 along an axis without stripes.

    Args:
        places_px: for each axis with stripes, the mean projector position of a pixel's direct light
            (not finite without such light), and the position that its centre sees, or NaN.
        straight: direct light of each pixel.
        stray2: for each axis with a pattern, the variance of its indirect light, in units of the
            variance of the pattern.
        samples: number of paths per pixel.
    """
    place, stray = np.zeros((2, 2, *straight.shape), dtype=np.float32)
    side_px = math.ceil(WINDOW_PX / math.sqrt(samples)) | 1  # At least 81 paths then count.
    for i, axis in enumerate(AXES):
        if axis not in places_px:
            continue
        mean_px, centre_px = places_px[axis]
        lit = np.isfinite(mean_px) & np.isfinite(centre_px)
        place[i] = _place_sigma(mean_px, centre_px, lit)
        if axis in stray2:
            off = np.sqrt(_near_mean(stray2[axis], lit, side_px))
            np.divide(off, straight, out=stray[i], where=lit)
    return PathNoise(place_sigma_px=place, stray=stray)


def _place_sigma(
    mean_px: Float[np.ndarray, "h w"],
    centre_px: Float[np.ndarray, "h w"],
    lit: Bool[np.ndarray, "h w"],
) -> Float[np.ndarray, "h w"]:
    """Return the residual's root mean square over neighbours, scaled to each pixel's footprint."""
    steps = [_steps(centre_px, axis) for axis in (0, 1)]
    slope2 = sum(np.nan_to_num(np.fmin(*np.abs(pair))) ** 2 for pair in steps)
    one_path = (1 + slope2) / np.float32(12)
    bend2 = sum((after - before) ** 2 for before, after in steps)
    with np.errstate(invalid="ignore"):  # NaN compares as false.
        plain = bend2 < MOST_BEND**2 * one_path
        share = (mean_px - centre_px) ** 2 / one_path
    plain &= cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.where(lit, np.sqrt(_near_mean(share, plain, WINDOW_PX) * one_path), np.float32(0))


def _steps(place_px: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "2 h w"]:
    """Return the differences to the previous and to the next neighbour; NaN without a neighbour."""
    none = np.full_like(np.take(place_px, [0], axis=axis), np.nan)
    step = np.diff(place_px, axis=axis)
    return np.stack([np.concatenate(pair, axis=axis) for pair in ((none, step), (step, none))])


def _near_mean(
    value: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"], side_px: int
) -> Float[np.ndarray, "h w"]:
    """Return the mean over known pixels in a square, or over the whole picture without any."""
    window = (side_px, side_px)
    total = cv2.boxFilter(np.where(known, value, np.float32(0)), -1, window, normalize=False)
    count = cv2.boxFilter(known.astype(np.float32), -1, window, normalize=False)
    whole = np.float32(value[known].mean() if known.any() else 0)
    near = np.where(count > 0.5, total / np.maximum(count, 1), whole)
    return np.maximum(near, 0)
