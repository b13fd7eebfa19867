"""Light of a projector's lines that is a little brighter or darker in every picture.

A laser line that sweeps over the scene is modulated in time, and its power is never quite what was
asked for: each line of each picture has its own relative error, from end to end or, with a length,
from place to place. Pixels that look at the same place of a line share it, so it makes noise that
neighbours along the projector's lines have in common, and none that neighbours across them have.
No exposure and no brightness helps against it.

Leaves out: errors that neighbouring lines share; that a camera's pixel may see several lines, or a
line's blur; light that came over other surfaces; that a length along a line looks shorter from
afar, and that lines may be inclined in the camera's picture.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float
from scipy import fft

from ..base.streams import CaptureStream, stream
from ..rig.pattern import Axis

_LEAST_WEIGHT = 1e-4  # Fine frequencies below this share of the greatest weight are not drawn.


def with_line_noise(
    stack: Float[np.ndarray, "n h w"],
    place_px: Float[np.ndarray, "h w"],
    share: float,
    *,
    axis: Axis,
    length_px: float = math.inf,
    seed: int,
) -> Float[np.ndarray, "n h w"]:
    """Return each picture's light times one plus the error of the projector line that lit it.

    The line is the projector column (or row) next to where a pixel's light comes from. How bright
    other pixels are has no influence.

    Args:
        place_px: where each pixel's light comes from along `axis` in the projector's picture; NaN
            where that is not known, which leaves the light as it is.
        share: the standard deviation of a line's relative error.
        axis: the projector axis across the lines.
        length_px: at which distance along a line, in the camera's picture, the errors have a
            correlation of 1/e: `exp(-(r / length_px)^2)`. Infinite: a line has one error.
    """
    known = np.isfinite(place_px)
    number = np.rint(np.where(known, place_px, 0)).astype(np.int64)
    number -= min(int(number.min()), 0)  # a line just outside the picture is one, too
    if math.isinf(length_px):
        lines, places, place = int(number.max()) + 1, 1, np.zeros_like(number)
    else:
        place = np.indices(number.shape)[0 if axis == "column" else 1]
        occurring, number = np.unique(number, return_inverse=True)
        lines, places = len(occurring), int(place.max()) + 1

    def with_error(k: int) -> Float[np.ndarray, "h w"]:
        rng = stream(seed, CaptureStream.LINES, k)
        error = _correlated(rng, places, lines, length_px)
        gain = np.maximum(1 + np.float32(share) * error[place, number], 0)
        return stack[k] * np.where(known, gain, np.float32(1))

    with ThreadPoolExecutor() as pool:  # NumPy and SciPy let several pictures be made at once
        return np.stack(list(pool.map(with_error, range(len(stack)))))


def _correlated(
    rng: np.random.Generator, places: int, lines: int, length_px: float
) -> Float[np.ndarray, "places lines"]:
    """Normal numbers of unit variance, alike along the lines and independent across them."""
    if math.isinf(length_px):
        return rng.standard_normal((places, lines), dtype=np.float32)
    count = fft.next_fast_len(places, real=True)
    far = np.arange(count)
    far = np.minimum(far, count - far)  # the last one is beside the first
    power = np.maximum(fft.fft(np.exp(-((far / length_px) ** 2))).real, 0)
    power /= power.mean()  # what was below 0 is of lengths like the ring's own
    weight = np.sqrt(count / 2 * power[: count // 2 + 1])
    weight[0] *= math.sqrt(2)  # a real number, as the last one of an even count is
    if count % 2 == 0:
        weight[-1] *= math.sqrt(2)
    weight = weight[: int(np.flatnonzero(weight > _LEAST_WEIGHT * weight.max())[-1]) + 1]
    # White noise has a white spectrum, so it is drawn there, up to the finest that the length has.
    spectrum = rng.standard_normal((len(weight), 2 * lines), dtype=np.float32).view(np.complex64)
    return fft.irfft(spectrum * weight.astype(np.float32)[:, None], n=count, axis=0)[:places]
