"""Laser speckle on the sensor, which makes light uneven within a pixel and shifts its centre.

Coherent light from a rough surface makes a pattern of speckles on the sensor, as fine as the lens
resolves. A pixel sums several speckles: its light varies by a contrast, and its centre of light is
off the centre of the pixel by a fraction of a pixel. All frames have the same pattern, as they are
taken through the same optics, so averaging does not help. Where the light changes across the
picture, this offset becomes an error of the decoded position (R. G. Dorsch, G. Haeusler,
J. M. Herrmann, "Laser triangulation: fundamental uncertainty in distance measurement", Applied
Optics 33, 1994).

The speckle pattern differs in every capture, because a surface that moves by a few micrometres, or
a laser wavelength that drifts by a few picometres, changes it completely.

The finish of a surface differs from patch to patch, and so does the contrast (`uneven`). In scans
of a real bin and its parts, the amplitude of the depth noise differs between patches of about
10 mm. This is a property of the surface: it is the same in every scan of the surface and follows
neither pixel nor projector ray. Brightness does not explain it (docs/measurements/twin.md).

Leaves out: the rings of the Airy pattern, 6 % of the contrast at two speckles across a pixel; the
effect of a metal's finish or of defocus on contrast; speckle of indirect light; any correlation of
brightness and displacement beyond their quotient; patches that move with their surface (each
capture has its own); the effect of distance on the size of patches in the picture.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float
from scipy import fft, ndimage

from ..base.kernels import kernel
from ..base.streams import CaptureStream, stream
from .sensor import SensorSpec

LAGS = 3  # Speckle is smaller than this many pixels, so pixels farther apart are independent.
MOST_REFLECTANCE = 0.95  # Without absorption the mean path of light in a material is infinite.
# Correlation length (1/e) of the finish on a surface, measured in five scans of a plastic bin and
# the parts in it.
PATCH_M = 0.010
FURTHEST_PX = 0.5  # The centre of a pixel's light is within the active area of the pixel.


@dataclass(frozen=True, slots=True, kw_only=True)
class Speckle:
    """Effect of speckle on each pixel: a factor for its light, and its centre's offset [px]."""

    brightness: Float[np.ndarray, "h w"]
    right_px: Float[np.ndarray, "h w"]
    down_px: Float[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


def shared_light(sensor: SensorSpec, lag_px: int, *, side: float = 1.0) -> float:
    """Return the covariance of two pixels' light, `lag_px` apart, for speckle of contrast 1.

    This is the factor for one axis; for pixels apart along both axes, multiply two factors. The
    autocorrelation of intensity is taken as a Gaussian `exp(-pi r^2 / A)` with the same area as for
    a round pupil, `A = (4 / pi) (lambda N)^2`. For pixels of side p the covariance is

        1/p integral (1 - |t| / p) exp(-pi (t + lag p)^2 / A) dt   from -p to p.

    At lag 0 its square is 1 over the number of speckles in a pixel. For a pixel with a smaller
    active square, p is multiplied by its `side` and the lag is divided by it.

    Source: J. W. Goodman, "Speckle Phenomena in Optics", 2007, section 4.5 (integrated speckle).
    """
    pitch_m = side * sensor.pixel_pitch_m
    pixels2 = 4 / math.pi * (sensor.wavelength_m * sensor.f_number / pitch_m) ** 2
    root = math.sqrt(math.pi / pixels2)

    def twice_integrated(t: float) -> float:
        """Return the second integral of the Gaussian, whose second difference is the covariance."""
        return t * math.erf(root * t) / (2 * root / math.sqrt(math.pi)) + pixels2 / (
            2 * math.pi
        ) * math.exp(-((root * t) ** 2))

    lag = lag_px / side
    return twice_integrated(lag + 1) + twice_integrated(lag - 1) - 2 * twice_integrated(lag)


def material_contrast(
    reflectance: Float[np.ndarray, "*n"], volume: float
) -> Float[np.ndarray, "*n"]:
    """Return the speckle contrast of a surface, relative to a black surface.

    Light that a material reflects has been scattered inside it. In the theory of Kubelka and Munk
    its mean path is `2 R / (1 - R^2)` scattering lengths, where R is the diffuse reflectance. Paths
    whose lengths differ by more than the coherence length do not interfere. For an exponential
    distribution of paths and a Lorentzian line, `C^2 = 1 / (1 + volume 2 R / (1 - R^2))`, where
    `volume` is twice the scattering length divided by the coherence length. So a black surface has
    more speckle than a white one.
    """
    R = np.clip(reflectance, 0.0, MOST_REFLECTANCE)
    return 1 / np.sqrt(1 + volume * 2 * R / (1 - R * R))


def uneven(
    amplitude: Float[np.ndarray, "h w"], unevenness: float, *, patch_px: float, seed: int
) -> Float[np.ndarray, "h w"]:
    """Return an amplitude of noise that varies with the finish of surfaces; it is at most 1.

    The given amplitude is multiplied by a log-normal field, whose logarithm has the standard
    deviation `unevenness` and the correlation `exp(-(r / patch_px)^2)`. The mean square of the
    amplitude, and so the mean power of the noise, does not change.

    Args:
        patch_px: size of `PATCH_M` in the picture [px].
        seed: seed of the field.
    """
    rng = stream(seed, CaptureStream.FINISH)
    field = rng.standard_normal(amplitude.shape, dtype=np.float32)
    field = ndimage.gaussian_filter(field, patch_px / 2, mode="wrap")
    field *= unevenness / max(float(field.std()), 1e-9)
    return np.minimum(amplitude * np.exp(field - np.float32(unevenness**2)), np.float32(1))


def pixel_contrast(sensor: SensorSpec, *, side: float = 1.0) -> float:
    """Return the speckle contrast of a whole pixel, relative to the contrast at a point."""
    return shared_light(sensor, 0, side=side)


def footprint_px(sensor: SensorSpec, *, side: float = 1.0) -> float:
    """Return the standard deviation of a pixel's centre of light for a pixel contrast of 1 [px].

    Its variance is 1/12 of the pixel's active square plus the square of `lambda N / pi`, the value
    for a point (Dorsch et al.) or for a pixel much smaller than a speckle.
    """
    point_px = sensor.wavelength_m * sensor.f_number / sensor.pixel_pitch_m / math.pi
    return math.hypot(side / math.sqrt(12), point_px)


def draw_speckle(
    contrast: Float[np.ndarray, "h w"], sensor: SensorSpec, *, seed: int, side: float = 1.0
) -> Speckle:
    """Draw speckle for pixels with these contrasts and an active square of a `side` [px].

    Brightness has a gamma distribution of mean 1 (integrated speckle, Goodman), computed as the
    cube of a normal number (E. B. Wilson, M. M. Hilferty, 1931). The first moment is
    independent and normal. The centre is moment over brightness, so in dark pixels it moves most.
    """
    rng = stream(seed, CaptureStream.SPECKLE)
    fields = _correlated(rng.standard_normal((3, *contrast.shape), dtype=np.float32), sensor, side)
    contrast = contrast.astype(np.float32)
    ninth = contrast**2 / 9  # 1 / (9 K) in the gamma law for K = 1 / C^2 speckles
    root = np.maximum(1 - ninth + np.sqrt(ninth) * fields[0], 0)
    middle = 1 - ninth
    brightness = root**3 / (middle**3 + 3 * middle * ninth)
    moment = np.float32(footprint_px(sensor, side=side)) * contrast * fields[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(brightness > 0, moment / brightness, 0)
    right, down = np.clip(place, -FURTHEST_PX * side, FURTHEST_PX * side)
    return Speckle(brightness=brightness, right_px=right, down_px=down)


def _correlated(
    white: Float[np.ndarray, "n h w"], sensor: SensorSpec, side: float
) -> Float[np.ndarray, "n h w"]:
    """Give white noise of unit variance the correlation of speckle in neighbouring pixels."""
    lags = [shared_light(sensor, lag, side=side) for lag in range(LAGS + 1)]
    share = [lag / lags[0] for lag in lags]
    spectrum = [_spectrum(size, share) for size in white.shape[1:]]
    half = spectrum[1][: white.shape[2] // 2 + 1]
    factor = np.sqrt(spectrum[0][:, None] * half).astype(np.float32)
    return fft.irfft2(fft.rfft2(white, axes=(1, 2)) * factor, s=white.shape[1:], axes=(1, 2))


def _spectrum(size: int, share: list[float]) -> Float[np.ndarray, " size"]:
    """Return the power spectrum, of mean 1, of a line of pixels with autocorrelation `share`."""
    angle = 2 * np.pi * np.arange(size) / size
    power = 1 + sum(2 * rho * np.cos(lag * angle) for lag, rho in enumerate(share) if lag)
    power = np.maximum(power, 0.0)
    return power / power.mean()


def speckled(stack: Float[np.ndarray, "n h w"], speckle: Speckle) -> Float[np.ndarray, "n h w"]:
    """Apply speckle to pictures: each pixel becomes brighter or darker, and its centre moves.

    The slope of a picture across a pixel is the mean of the two differences to its neighbours, but
    at most twice the smaller one, and 0 if they have different signs. So another surface next to a
    silhouette has little influence, and no light becomes negative.

    Source of the slope: B. van Leer, "Towards the ultimate conservative difference scheme IV",
    1977 (monotonised central differences).
    """
    out = np.empty(stack.shape, dtype=np.float32)
    maps = (stack, speckle.brightness, speckle.right_px, speckle.down_px)
    seen = [np.ascontiguousarray(each, dtype=np.float32).view() for each in maps]
    for each in seen:
        each.flags.writeable = False  # Numba compiles a kernel once if all arrays are read-only.
    _weigh(*seen, out)
    return out


@kernel(parallel=True)
def _weigh(stack, brightness, right, down, out):
    n, h, w = stack.shape
    for y in numba.prange(h):
        above, below = max(y - 1, 0), min(y + 1, h - 1)
        for k in range(n):
            for x in range(w):
                here = stack[k, y, x]
                along = _slope(stack[k, y, max(x - 1, 0)], here, stack[k, y, min(x + 1, w - 1)])
                across = _slope(stack[k, above, x], here, stack[k, below, x])
                light = here + right[y, x] * along + down[y, x] * across
                out[k, y, x] = brightness[y, x] * max(light, np.float32(0))


@kernel()
def _slope(before, here, after):
    first, second = here - before, after - here
    if first * second <= 0:
        return np.float32(0)
    least = np.float32(2) * min(abs(first), abs(second))
    middle = np.float32(0.5) * (first + second)
    return middle if abs(middle) <= least else math.copysign(least, middle)
