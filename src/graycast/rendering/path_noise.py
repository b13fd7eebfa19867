"""What a finite number of light paths leaves of error in a pixel's patterns, from its own paths.

All patterns of a stack share their paths, so the error of a pixel is in where these paths met the
projector's picture: the mean place of its straight light is off the place that the pixel's centre
sees, by the scatter of the paths over the pixel and by the projector's square pixels. That residual
is known, as the surface at the centre is; its mean square over neighbours is the variance. It is
taken in units of the variance of one path, which is the pixel's footprint in the projector's
picture and the square of a projector pixel, so that neighbours on other slopes count as well.
Pixels beside an edge or a shadow do not count, whose residual many paths would not remove.

Light that other surfaces sent on comes from anywhere in the picture. The sum over the paths of its
squares is the variance of that light.

Leaves out: pixels that see two surfaces, whose mixture depends on few paths (they have what
their neighbours have); the part of interreflected light that all paths have in common,
which moves decoded places in the limit of many paths, too.
"""

import math
from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Bool, Float

from ..rig.pattern import AXES, Axis
from .radiance import PathNoise

WINDOW_PX = 9  # Squared errors are averaged over a square with this side: 81 values.
MOST_BEND = 1.0  # Places along three pixels that bend by fewer sigmas of a path have no edge.


def path_noise(
    places_px: Mapping[Axis, tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]],
    straight: Float[np.ndarray, "h w"],
    stray2: Mapping[Axis, Float[np.ndarray, "h w"]],
    *,
    samples: int,
) -> PathNoise:
    """Standard deviations from sums over the paths of each pixel; 0 along an axis without stripes.

    Args:
        places_px: along each axis with stripes, the mean projector place of a pixel's straight
            light, not finite without any, and the place that its centre sees, NaN if it sees none.
        straight: a pixel's straight light.
        stray2: of a pattern along an axis, if there is any: the variance of its interreflected
            light, in units of the straight light squared and of the pattern's own variance.
        samples: paths of a pixel.
    """
    place, stray = np.zeros((2, 2, *straight.shape), dtype=np.float32)
    side_px = math.ceil(WINDOW_PX / math.sqrt(samples)) | 1  # so that 81 paths or more count
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
    """The residual's root mean square over neighbours, for the footprint of each pixel."""
    steps = [_steps(centre_px, axis) for axis in (0, 1)]
    slope2 = sum(np.nan_to_num(np.fmin(*np.abs(pair))) ** 2 for pair in steps)
    one_path = (1 + slope2) / np.float32(12)
    bend2 = sum((after - before) ** 2 for before, after in steps)
    with np.errstate(invalid="ignore"):  # NaN is not <
        plain = bend2 < MOST_BEND**2 * one_path
        share = (mean_px - centre_px) ** 2 / one_path
    plain &= cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.where(lit, np.sqrt(_near_mean(share, plain, WINDOW_PX) * one_path), np.float32(0))


def _steps(place_px: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "2 h w"]:
    """To a place from that of its neighbour before, and on to the next one; NaN without any."""
    none = np.full_like(np.take(place_px, [0], axis=axis), np.nan)
    step = np.diff(place_px, axis=axis)
    return np.stack([np.concatenate(pair, axis=axis) for pair in ((none, step), (step, none))])


def _near_mean(
    value: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"], side_px: int
) -> Float[np.ndarray, "h w"]:
    """The mean over the known pixels of a square; over the whole picture where none is known."""
    window = (side_px, side_px)
    total = cv2.boxFilter(np.where(known, value, np.float32(0)), -1, window, normalize=False)
    count = cv2.boxFilter(known.astype(np.float32), -1, window, normalize=False)
    whole = np.float32(value[known].mean() if known.any() else 0)
    near = np.where(count > 0.5, total / np.maximum(count, 1), whole)
    return np.maximum(near, 0)
