"""Laser speckle on the sensor: light that is uneven within each pixel, and so seen off its centre.

Coherent light from a rough surface makes a pattern of speckles on the sensor, as fine as the lens
resolves. A pixel sums several of them: its light varies by a contrast, and its centre of light lies
off its own centre by a part of the pixel. Every frame is taken through the same optics, so all have
the same pattern: averaging frames does not help, and a slope of the pattern in the picture becomes
an error of the decoded position (R. G. Dorsch, G. Haeusler, J. M. Herrmann, "Laser triangulation:
fundamental uncertainty in distance measurement", Applied Optics 33, 1994).

The pattern is another one in every capture: a few micrometres that a surface moved, a few
picometres of the laser's wavelength, change it wholly.

The finish of a surface differs from patch to patch, and so does the contrast (`uneven`). In scans
of a real bin and its parts, the amplitude of the depth noise differs between patches of about
10 mm. It belongs to the surface: it is the same in every scan of a surface, and neither the same
pixel nor the same ray of the projector has it on another surface. Brightness does not explain it
(docs/measurements/twin.md).

Leaves out: the rings of Airy's pattern, 6 % of the contrast at two speckles across a pixel; a
contrast that changes with a metal's finish or with defocus; speckle of light that came over other
surfaces; the correlation of brightness with displacement beyond their quotient; patches that move
with their surface, since a capture has patches of its own; their size in the picture by distance.
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

LAGS = 3  # Pixels farther apart have independent speckle, because a speckle is smaller.
MOST_REFLECTANCE = 0.95  # A mean path in matter without any absorption has no end.
# At this distance on a surface, the finish of two places has a correlation of 1/e. It was measured
# on five scans of one bin of plastic, the parts in it included.
PATCH_M = 0.010
FURTHEST_PX = 0.5  # Light that a pixel gathers has its centre within what the pixel senses with.


@dataclass(frozen=True, slots=True, kw_only=True)
class Speckle:
    """What speckle does to each pixel: a factor of its light, and the place of its centre [px]."""

    brightness: Float[np.ndarray, "h w"]
    right_px: Float[np.ndarray, "h w"]
    down_px: Float[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


def shared_light(sensor: SensorSpec, lag_px: int, *, side: float = 1.0) -> float:
    """Covariance of two pixels' light, `lag_px` apart along a line, for speckle of contrast 1.

    It is one axis's factor: of two pixels apart along both axes, the product. With the intensity's
    autocorrelation `exp(-pi r^2 / A)`, a Gaussian of the area `A = (4 / pi) (lambda N)^2` that the
    round pupil's has, and pixels of the side p it is

        1/p integral (1 - |t| / p) exp(-pi (t + lag p)^2 / A) dt   from -p to p.

    At lag 0 its square is one over the number of speckles in a pixel. A pixel that senses with a
    square in its middle alone has that square's `side` times p for p, and its neighbours lie
    farther apart in it.

    Source: J. W. Goodman, "Speckle Phenomena in Optics", 2007, section 4.5 (integrated speckle).
    """
    pitch_m = side * sensor.pixel_pitch_m
    pixels2 = 4 / math.pi * (sensor.wavelength_m * sensor.f_number / pitch_m) ** 2
    root = math.sqrt(math.pi / pixels2)

    def twice_integrated(t: float) -> float:
        """Of the Gaussian; second differences of it are the integral with the triangle."""
        return t * math.erf(root * t) / (2 * root / math.sqrt(math.pi)) + pixels2 / (
            2 * math.pi
        ) * math.exp(-((root * t) ** 2))

    lag = lag_px / side
    return twice_integrated(lag + 1) + twice_integrated(lag - 1) - 2 * twice_integrated(lag)


def material_contrast(
    reflectance: Float[np.ndarray, "*n"], volume: float
) -> Float[np.ndarray, "*n"]:
    """Contrast of a surface's speckle as a share of a black one's.

    Light that a material gives back has wandered through it: by the theory of Kubelka and Munk over
    the mean path `2 R / (1 - R^2)` in units of one over its scattering coefficient, R being its
    diffuse reflectance. Paths that differ by more than the light is coherent over do not interfere.
    With exponentially spread paths and a Lorentzian line `C^2 = 1 / (1 + volume 2 R / (1 - R^2))`,
    `volume` being twice the scattering length over the coherence length. So a black surface
    speckles more than a white one.
    """
    R = np.clip(reflectance, 0.0, MOST_REFLECTANCE)
    return 1 / np.sqrt(1 + volume * 2 * R / (1 - R * R))


def uneven(
    amplitude: Float[np.ndarray, "h w"], unevenness: float, *, patch_px: float, seed: int
) -> Float[np.ndarray, "h w"]:
    """An amplitude of noise, at most 1, on surfaces whose finish differs from patch to patch.

    It is multiplied by a field with a log-normal law, whose logarithm has the standard deviation
    `unevenness` and the correlation `exp(-(r / patch_px)^2)`. The mean square of the amplitude
    stays what it was, and so does the mean power of the noise.

    Args:
        patch_px: `PATCH_M` in the picture.
        seed: of the field.
    """
    rng = stream(seed, CaptureStream.FINISH)
    field = rng.standard_normal(amplitude.shape, dtype=np.float32)
    field = ndimage.gaussian_filter(field, patch_px / 2, mode="wrap")
    field *= unevenness / max(float(field.std()), 1e-9)
    return np.minimum(amplitude * np.exp(field - np.float32(unevenness**2)), np.float32(1))


def pixel_contrast(sensor: SensorSpec, *, side: float = 1.0) -> float:
    """What summing over a pixel leaves of the contrast at a point of the sensor."""
    return shared_light(sensor, 0, side=side)


def footprint_px(sensor: SensorSpec, *, side: float = 1.0) -> float:
    """By how much speckle of contrast 1 over a pixel would move its centre of light (one sigma).

    `1 / 12` of the square that a pixel senses with, and the `lambda N / pi` of a point (Dorsch et
    al.), which is what a pixel much smaller than a speckle has.
    """
    point_px = sensor.wavelength_m * sensor.f_number / sensor.pixel_pitch_m / math.pi
    return math.hypot(side / math.sqrt(12), point_px)


def draw_speckle(
    contrast: Float[np.ndarray, "h w"], sensor: SensorSpec, *, seed: int, side: float = 1.0
) -> Speckle:
    """A pattern for pixels of a given contrast each, that sense with a square of a `side` [px].

    Brightness has a gamma law of mean 1 (integrated speckle, Goodman), by the cube of a normal
    number (E. B. Wilson, M. M. Hilferty, 1931). The moment of light about the pixel's centre is
    normal and independent of it; the centre is their quotient, so dark pixels are moved farthest.
    """
    rng = stream(seed, CaptureStream.SPECKLE)
    fields = _correlated(rng.standard_normal((3, *contrast.shape), dtype=np.float32), sensor, side)
    contrast = contrast.astype(np.float32)
    ninth = contrast**2 / 9  # 1 / (9 K) of a gamma law of K = 1 / C^2 speckles
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
    """White noise of unit variance with the correlation that neighbouring pixels' speckle has."""
    lags = [shared_light(sensor, lag, side=side) for lag in range(LAGS + 1)]
    share = [lag / lags[0] for lag in lags]
    spectrum = [_spectrum(size, share) for size in white.shape[1:]]
    half = spectrum[1][: white.shape[2] // 2 + 1]
    factor = np.sqrt(spectrum[0][:, None] * half).astype(np.float32)
    return fft.irfft2(fft.rfft2(white, axes=(1, 2)) * factor, s=white.shape[1:], axes=(1, 2))


def _spectrum(size: int, share: list[float]) -> Float[np.ndarray, " size"]:
    """Power at each frequency of a line of pixels with that autocorrelation; its mean is 1."""
    angle = 2 * np.pi * np.arange(size) / size
    power = 1 + sum(2 * rho * np.cos(lag * angle) for lag, rho in enumerate(share) if lag)
    power = np.maximum(power, 0.0)
    return power / power.mean()


def speckled(stack: Float[np.ndarray, "n h w"], speckle: Speckle) -> Float[np.ndarray, "n h w"]:
    """Pictures as speckle weighs the light within each pixel: brighter or darker, and displaced.

    A picture's slope across a pixel is the middle of its neighbours', at most twice either: at a
    silhouette, where one neighbour's light is another surface's, it is the pixel's own. So no light
    is negative, and none comes from beyond the pixel.

    Source of the slope: B. van Leer, "Towards the ultimate conservative difference scheme IV",
    1977 (monotonised central differences).
    """
    out = np.empty(stack.shape, dtype=np.float32)
    maps = (stack, speckle.brightness, speckle.right_px, speckle.down_px)
    seen = [np.ascontiguousarray(each, dtype=np.float32).view() for each in maps]
    for each in seen:
        each.flags.writeable = False  # one kind of array to compile for, whoever made it
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
