"""From radiance to digital numbers: exposure, noise, saturation, quantisation.

A linear monochrome sensor in EMVA 1288 terms. Every pixel of every frame draws from its own
counter-based random stream, so the result depends on the seed alone, not on the number of threads.

Leaves out: dark current, fixed-pattern noise, lens falloff, blooming, colour filters (each band
of the colour picture is taken by a sensor of its own).
"""

import math
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, UInt8, UInt16

EXACT_POISSON_BELOW_E = 64.0  # above, a normal law: the skewness left out is under 1 / 8


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """A linear sensor. `responsivity` is electrons per second for a radiance of 1 W sr^-1 m^-2.

    The default responsivity is that of a 3.45 um pixel with quantum efficiency 0.6 behind a lens at
    f/8 in green light: pi / (4 N^2) * area * efficiency * wavelength / (h c).
    """

    full_well_e: float = 10_000.0
    read_noise_e: float = 3.0
    gain_dn_per_e: float = 0.39
    offset_dn: float = 64.0
    bit_depth: int = 12
    responsivity: float = 2.4e5

    def __post_init__(self) -> None:
        if not 1 <= self.bit_depth <= 16:
            raise ValueError(f"bit_depth is {self.bit_depth}; the sensor stores 1 to 16 bits")
        for name in ("full_well_e", "gain_dn_per_e", "responsivity"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be positive")
        if not self.read_noise_e >= 0:
            raise ValueError(f"read_noise_e is {self.read_noise_e}; it must be 0 or more")
        if not 0 <= self.offset_dn < self.max_dn:
            raise ValueError(f"offset_dn is {self.offset_dn}; it must lie in 0 to {self.max_dn}")

    @property
    def max_dn(self) -> int:
        return 2**self.bit_depth - 1

    @property
    def saturation_dn(self) -> float:
        """The digital number at which either the well or the converter is full."""
        return min(float(self.max_dn), self.offset_dn + self.gain_dn_per_e * self.full_well_e)


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """A stack of pictures as the sensor stored them [DN]."""

    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"]
    sensor: SensorSpec
    exposure_s: float

    def __post_init__(self) -> None:
        self.frames.flags.writeable = False


def auto_exposure_s(
    brightest: Float[np.ndarray, "*n"], sensor: SensorSpec, *, percentile: float, target: float
) -> float:
    """The exposure that puts a percentile of the brightest frame at a share of saturation.

    Args:
        brightest: radiance of the brightest frame, any shape [W sr^-1 m^-2].
        percentile: 0 to 100, of all its pixels.
        target: share of the range between offset and saturation, 0 to 1.

    Raises:
        ValueError: nothing in the frame is lit at that percentile.
    """
    level = float(np.percentile(brightest, percentile))
    if not level > 0:
        raise ValueError(
            f"percentile {percentile} of the brightest frame is {level}: the scene is dark there; "
            "set exposure_s, raise the percentile, or point the rig at the scene"
        )
    range_e = (sensor.saturation_dn - sensor.offset_dn) / sensor.gain_dn_per_e
    return target * range_e / (sensor.responsivity * level)


def expose(
    radiance: Float[np.ndarray, "n h w"],
    background: Float[np.ndarray, "h w"] | None,
    sensor: SensorSpec,
    *,
    exposure_s: float,
    seed: int,
) -> Capture:
    """Take a picture of each radiance image, all with one exposure and independent noise.

    Args:
        radiance: one image per frame [W sr^-1 m^-2].
        background: light that is in every frame beside it [W sr^-1 m^-2].
        seed: of the noise; frames and pixels are independent of one another.

    Raises:
        ValueError: the exposure is not positive, or radiance is negative or not finite.

    Source: EMVA Standard 1288, release 4.0, linear camera model.
    """
    if not 0 < exposure_s < math.inf:
        raise ValueError(f"exposure_s is {exposure_s}; it must be positive")
    if not 0 <= radiance.min() <= radiance.max() < math.inf:  # NaN must fail too
        span = f"{radiance.min()} to {radiance.max()}"
        raise ValueError(f"radiance spans {span} W/(sr m^2); it must be finite and not negative")
    n, h, w = radiance.shape
    frames = np.empty((n, h, w), dtype=np.uint8 if sensor.bit_depth <= 8 else np.uint16)
    # The seed is hashed by numpy, so that near seeds give unrelated streams.
    key = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
    _expose(
        radiance.reshape(n, h * w),
        np.zeros(h * w, dtype=np.float32) if background is None else background.reshape(h * w),
        frames.reshape(n, h * w),
        sensor.responsivity * exposure_s,
        sensor.full_well_e,
        sensor.read_noise_e,
        sensor.gain_dn_per_e,
        sensor.offset_dn,
        sensor.max_dn,
        key,
    )
    return Capture(frames=frames, sensor=sensor, exposure_s=exposure_s)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _mix(z: np.uint64) -> np.uint64:
    """Finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014): 64 well-mixed bits."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(parallel=True, cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _expose(
    radiance, background, frames, scale, full_well_e, read_noise_e, gain, offset_dn, max_dn, key
):
    n, pixels = radiance.shape
    for pixel in numba.prange(pixels):
        for k in range(n):
            mean_e = (radiance[k, pixel] + background[pixel]) * scale
            counter = np.uint64(k) * np.uint64(pixels) + np.uint64(pixel)
            bits = _mix(key + counter * np.uint64(0x9E3779B97F4A7C15))
            # Two uniforms of 32 bits, never 0, from one draw.
            u = (np.float64(bits >> np.uint64(32)) + 0.5) * 2.0**-32
            v = (np.float64(bits & np.uint64(0xFFFFFFFF)) + 0.5) * 2.0**-32
            if mean_e < EXACT_POISSON_BELOW_E:
                signal_e = np.float64(_poisson(mean_e, _mix(bits)))
                noise_e = read_noise_e
            else:
                signal_e = mean_e
                noise_e = math.sqrt(mean_e + read_noise_e * read_noise_e)
            normal = math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)
            signal_e = min(signal_e + noise_e * normal, full_well_e)
            dn = math.floor(gain * signal_e + offset_dn + 0.5)
            frames[k, pixel] = min(max(dn, 0), max_dn)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _poisson(mean: float, bits: np.uint64) -> int:
    """A Poisson number by inversion of its distribution function at one uniform draw."""
    u = (np.float64(bits >> np.uint64(11)) + 0.5) * 2.0**-53
    k, probability = 0, math.exp(-mean)
    cumulative = probability
    while u > cumulative and k < 1000:  # the bound is met only by rounding at u -> 1
        k += 1
        probability *= mean / k
        cumulative += probability
    return k
