"""Random errors in the brightness of projector lines, which differ from picture to picture.

A laser line that sweeps over the scene is modulated in time, and its power deviates at random from
the wanted value. Each line of each picture has its own relative error. It is constant along the
line or, with a correlation length, varies along it. Pixels that see the same point of a line share
its error, so the noise is correlated along the projector's lines and independent across them.
Longer exposure or more light does not reduce it.

Leaves out: correlation between adjacent lines; pixels that see several lines; the blur of a line;
indirect light; perspective and inclination of the lines in the camera's picture.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float
from scipy import fft

from ..base.streams import CaptureStream, stream
from ..rig.pattern import Axis

_LEAST_WEIGHT = 1e-4  # High frequencies with less than this share of the largest weight are 0.


def with_line_noise(
    stack: Float[np.ndarray, "n h w"],
    place_px: Float[np.ndarray, "h w"],
    share: float,
    *,
    axis: Axis,
    length_px: float = math.inf,
    seed: int,
) -> Float[np.ndarray, "n h w"]:
    """Return the pictures with the light of each pixel multiplied by the error of its line.

    A pixel's line is the projector column (or row) that is nearest to the position from which the
    pixel is lit. The factor is 1 plus the relative error. Other pixels have no influence.

    Args:
        place_px: position along `axis` in the projector's picture that lights each pixel; NaN if
            it is unknown, in which case the light is unchanged.
        share: standard deviation of a line's relative error.
        axis: the projector axis across the lines.
        length_px: correlation length along a line, in the camera's picture: the correlation is
            `exp(-(r / length_px)^2)`. Infinite: the error is constant along a line.
    """
    known = np.isfinite(place_px)
    number = np.rint(np.where(known, place_px, 0)).astype(np.int64)
    number -= min(int(number.min()), 0)  # The lines just outside the picture count, too.
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

    with ThreadPoolExecutor() as pool:  # NumPy and SciPy release Python's lock.
        return np.stack(list(pool.map(with_error, range(len(stack)))))


def _correlated(
    rng: np.random.Generator, places: int, lines: int, length_px: float
) -> Float[np.ndarray, "places lines"]:
    """Draw normal numbers of unit variance, correlated along lines and independent across them."""
    if math.isinf(length_px):
        return rng.standard_normal((places, lines), dtype=np.float32)
    count = fft.next_fast_len(places, real=True)
    far = np.arange(count)
    far = np.minimum(far, count - far)  # Places form a ring, so the last is next to the first.
    power = np.maximum(fft.fft(np.exp(-((far / length_px) ** 2))).real, 0)
    power /= power.mean()  # Clipping at 0 changes the mean only for lengths near the ring's size.
    weight = np.sqrt(count / 2 * power[: count // 2 + 1])
    weight[0] *= math.sqrt(2)  # This coefficient is real; so is the last one for an even count.
    if count % 2 == 0:
        weight[-1] *= math.sqrt(2)
    weight = weight[: int(np.flatnonzero(weight > _LEAST_WEIGHT * weight.max())[-1]) + 1]
    # The spectrum of white noise is white, so noise is drawn in the frequency domain.
    spectrum = rng.standard_normal((len(weight), 2 * lines), dtype=np.float32).view(np.complex64)
    return fft.irfft(spectrum * weight.astype(np.float32)[:, None], n=count, axis=0)[:places]
