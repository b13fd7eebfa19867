"""From radiance to digital numbers: exposure, noise, saturation, quantisation.

The sensor is linear and monochrome, in the terms of EMVA 1288. The steps follow the hardware:
photons and dark current are counted (Poisson), the well clips the electrons, the read-out adds
noise, the converter rounds and clips. Each pixel of each frame has its own counter-based random
stream (a hash of seed, frame and pixel), so the result depends on the seed and not on the number
of threads. The fixed pattern has its own seed, because it belongs to the sensor and not to a shot.

Leaves out: non-linearity, blooming, lag, rows or columns in the fixed pattern, hot pixels, a dark
current that differs between pixels, colour filters (the bands of the colour picture are taken one
after the other and share the fixed pattern). The falloff of the lens is part of the optics.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numba
import numpy as np
from jaxtyping import Float
from pydantic import Field

from ..base import array_types as arrays
from ..base.kernels import kernel
from ..base.public_value import public_value
from ..base.settings import Level, Positive, check_fields
from ..base.streams import CaptureStream

PLANCK_J_S = 6.62607015e-34
LIGHT_SPEED_M_S = 299_792_458.0
EXACT_POISSON_BELOW_E = 64.0  # Above, the skewness is below 1 / 8, and a normal law is used.
# A full well has read noise, so values up to this many standard deviations lower count as full.
SATURATION_SIGMAS = 4.0


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """A linear sensor with the aperture of its lens; the default is a 5-megapixel CMOS chip.

    The fixed patterns (`dsnu_e`, `prnu`) are white and depend only on `fpn_seed`, so they are the
    same in every capture. Different devices need different seeds.
    """

    pixel_pitch_m: Annotated[
        float, Field(gt=0, le=1e-3, description="The side of a pixel in metres.")
    ] = 3.45e-6
    quantum_efficiency: Annotated[
        float, Field(gt=0, le=1, description="The electrons per photon of wavelength_m.")
    ] = 0.6
    wavelength_m: Annotated[
        float, Field(gt=0, le=1e-4, description="Wavelength of the measured light in metres.")
    ] = 525e-9
    f_number: Annotated[Positive, Field(description="The f-number of the lens.")] = 8.0
    lens_transmission: Annotated[
        float, Field(gt=0, le=1, description="The share of the light that passes the lens.")
    ] = 1.0
    full_well_e: Annotated[Positive, Field(description="The electrons that a pixel can hold.")] = (
        10_000.0
    )
    read_noise_e: Annotated[
        Level, Field(description="The standard deviation of the read noise in electrons.")
    ] = 3.0
    dark_current_e_s: Annotated[
        Level, Field(description="The dark current in electrons per second.")
    ] = 1.0
    gain_dn_per_e: Annotated[Positive, Field(description="The digital numbers per electron.")] = (
        0.39
    )
    offset_dn: Annotated[
        Level, Field(description="The mean stored value without light, in digital numbers.")
    ] = 64.0
    bit_depth: Annotated[
        int, Field(ge=1, le=16, description="The number of bits of a stored value.")
    ] = 12
    dsnu_e: Annotated[
        float,
        Field(ge=0, description="Standard deviation of the pixels' offsets in electrons (DSNU)."),
    ] = 0.0
    prnu: Annotated[
        float,
        Field(
            ge=0,
            lt=0.25,
            description="Standard deviation of the pixels' gains, "
            "relative to the mean gain (PRNU).",
        ),
    ] = 0.0
    fpn_seed: Annotated[
        int,
        Field(
            ge=0,
            description="Seed of both fixed patterns and of the raster of faults, which belong to "
            "the device and not to the scene. Without this key in the scanner's section, each "
            "scanner after the first has a seed that follows from its name.",
        ),
    ] = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.offset_dn < self.max_dn:
            raise ValueError(
                f"offset_dn is {self.offset_dn:g}; it must be below {self.max_dn}, the largest "
                f"value of {self.bit_depth} bits: lower offset_dn, or raise bit_depth"
            )
        if not self.saturation_dn > self.offset_dn:
            raise ValueError(
                f"full_well_e is {self.full_well_e}; it must exceed {SATURATION_SIGMAS:g} times "
                f"the read noise and dsnu_e, here {self._full_well_margin_e:.3g}"
            )

    @property
    def responsivity(self) -> float:
        """Electrons per second for a radiance of 1 W sr^-1 m^-2.

        With a lens focused far away, the camera equation gives the irradiance
        `E = pi L T / (4 N^2)`, and a pixel of area `p^2` yields `E p^2 eta wavelength / (h c)`.
        """
        irradiance = math.pi * self.lens_transmission / (4 * self.f_number**2)
        photons = self.pixel_pitch_m**2 * self.wavelength_m / (PLANCK_J_S * LIGHT_SPEED_M_S)
        return irradiance * photons * self.quantum_efficiency

    @property
    def max_dn(self) -> int:
        return 2**self.bit_depth - 1

    @property
    def saturation_dn(self) -> float:
        """The digital number from which a stored value counts as saturated.

        It is the converter's maximum or, if lower, the full well minus `SATURATION_SIGMAS` of
        read noise (with `dsnu_e`).
        """
        well_e = self.full_well_e - self._full_well_margin_e
        return min(float(self.max_dn), self.offset_dn + self.gain_dn_per_e * well_e)

    @property
    def _full_well_margin_e(self) -> float:
        return SATURATION_SIGMAS * math.hypot(self.read_noise_e, self.dsnu_e)

    def variance_dn2(self, stored_dn: arrays.NumArray_any | float) -> arrays.FloatArray_any | float:
        """Return the temporal noise variance of a stored value y [DN^2].

        The photon transfer law is `K (y - offset) + K^2 read^2 + 1/12`. Both light and dark current
        are electrons that are counted above the offset, so dark current needs no separate term.

        Args:
            stored_dn: expected value, with offset; the value of a single frame is an estimate.

        Source: EMVA Standard 1288, release 4.0, equation of the photon transfer method.
        """
        floor_dn2 = (self.gain_dn_per_e * self.read_noise_e) ** 2 + 1 / 12
        return self.gain_dn_per_e * np.maximum(stored_dn - self.offset_dn, 0.0) + floor_dn2


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """A stack of pictures as the sensor stored them [DN].

    `exposure_s` is a map if each pixel has its own exposure time (`merge_exposures`). Light is then
    scaled to one of the times, `reference_s`, for comparison. `times_s` has the times of all
    exposures that were taken, even those that no pixel uses.
    """

    frames: arrays.UInt8or16Array_n_h_w
    sensor: SensorSpec
    exposure_s: float | arrays.FloatArray_h_w
    reference_s: float = math.nan  # NaN becomes the shortest exposure time.
    times_s: tuple[float, ...] = ()  # Without any, they are the exposure times of the pixels.

    def __post_init__(self) -> None:
        if math.isnan(self.reference_s):
            object.__setattr__(self, "reference_s", float(np.min(self.exposure_s)))
        if not self.times_s:
            object.__setattr__(self, "times_s", tuple(np.unique(self.exposure_s).tolist()))
        self.frames.flags.writeable = False
        if isinstance(self.exposure_s, np.ndarray):
            self.exposure_s.flags.writeable = False


def auto_exposure_s(
    brightest: Float[np.ndarray, "*n"], sensor: SensorSpec, *, percentile: float, target: float
) -> float:
    """Return the exposure time that puts a percentile of the brightest frame at `target`.

    Args:
        brightest: radiance of the brightest frame, any shape [W sr^-1 m^-2].
        percentile: percentile of all its pixels, 0 to 100.
        target: share of the range between offset and saturation, 0 to 1.

    Raises:
        ValueError: the frame is dark at that percentile.
    """
    level = float(np.percentile(brightest, percentile))
    if not level > 0:
        raise ValueError(
            f"percentile {percentile} of the brightest frame is {level}: the scene is too dark "
            "for automatic exposure; set exposure_s, raise the percentile, or point the rig at "
            "the scene"
        )
    range_e = (sensor.saturation_dn - sensor.offset_dn) / sensor.gain_dn_per_e
    return target * range_e / (sensor.responsivity * level + sensor.dark_current_e_s)


def expose(
    radiance: Float[np.ndarray, "n h w"],
    background: Float[np.ndarray, "h w"] | Float[np.ndarray, "n h w"] | None,
    sensor: SensorSpec,
    *,
    exposure_s: float,
    seed: int,
) -> Capture:
    """Take a picture of each radiance image, all with one exposure and independent noise.

    Args:
        radiance: one image per frame [W sr^-1 m^-2].
        background: light that is added to every frame, or one image per frame [W sr^-1 m^-2].
        seed: seed of the noise, which is independent between frames and pixels.

    Raises:
        ValueError: the exposure is not positive, or radiance is negative or not finite.

    Source: EMVA Standard 1288, release 4.0, linear camera model.
    """
    if background is not None and background.ndim == 3:
        radiance, background = radiance + background, None
    if not 0 < exposure_s < math.inf:
        raise ValueError(f"exposure_s is {exposure_s}; it must be positive")
    if not 0 <= radiance.min() <= radiance.max() < math.inf:  # Also False for NaN
        span = f"{radiance.min()} to {radiance.max()}"
        raise ValueError(f"radiance spans {span} W/(sr m^2); it must be finite and not negative")
    n, h, w = radiance.shape
    frames = np.empty((n, h, w), dtype=np.uint8 if sensor.bit_depth <= 8 else np.uint16)
    dark = np.zeros(h * w, dtype=np.float32) if background is None else background.reshape(h * w)
    light = np.ascontiguousarray(radiance.reshape(n, h * w)).view(), dark.view()
    for values in light:
        values.flags.writeable = False  # Numba compiles a kernel once if all arrays are read-only.
    shot = _Shot(
        scale=sensor.responsivity * exposure_s,
        dark_e=sensor.dark_current_e_s * exposure_s,
        full_well_e=sensor.full_well_e,
        read_noise_e=sensor.read_noise_e,
        gain=sensor.gain_dn_per_e,
        offset_dn=sensor.offset_dn,
        max_dn=sensor.max_dn,
        prnu=sensor.prnu,
        dsnu_e=sensor.dsnu_e,
        key=_key(seed),
        fpn_key=_key(sensor.fpn_seed, CaptureStream.FIXED_PATTERN),
    )
    _expose(*light, frames.reshape(n, h * w), shot)
    return Capture(frames=frames, sensor=sensor, exposure_s=exposure_s)


def merge_exposures(captures: Sequence[Capture]) -> Capture:
    """Merge exposures of a still scene into one stack, with one exposure per pixel (HDR).

    All frames of a pixel come from the longest exposure in which none of them is saturated, or
    from the shortest exposure if all are saturated. The stored numbers do not change, so a pixel
    has the noise of a single exposure and its frames can be compared.

    Args:
        captures: captures of the same scene with the same sensor and code, in any order.

    Returns:
        A capture whose `exposure_s` is a float32 map, whose `reference_s` is that of the shortest
        exposure and whose `times_s` has all times. A single capture is returned unchanged.

    Raises:
        ValueError: no captures, different sensors or sizes, or a capture that is already merged.

    Leaves out: means of several exposures, which would have less noise but another law of noise.
    Near saturation, noise decides which exposure a pixel gets, which lowers its mean slightly.
    """
    if not captures:
        raise ValueError("no captures are given to merge; give at least one")
    if any(isinstance(capture.exposure_s, np.ndarray) for capture in captures):
        raise ValueError("one of the captures is already merged; give single exposures")
    first, *longer = sorted(captures, key=lambda capture: capture.exposure_s)
    for other in longer:
        if (other.frames.shape, other.sensor) != (first.frames.shape, first.sensor):
            raise ValueError(
                f"captures of {first.frames.shape} and {other.frames.shape} values, or of two "
                "sensors, cannot be merged; take them with one sensor and one code"
            )
    if not longer:
        return first
    frames = first.frames.copy()
    exposure_s = np.full(frames.shape[1:], first.exposure_s, dtype=np.float32)
    saturation_dn = stored_saturation_dn(first.sensor)
    for other in longer:
        _take_unsaturated(other.frames, saturation_dn, other.exposure_s, frames, exposure_s)
    times_s = tuple(float(np.min(capture.exposure_s)) for capture in captures)
    return replace(first, frames=frames, exposure_s=exposure_s, times_s=times_s)


def stored_saturation_dn(sensor: SensorSpec) -> int:
    """Return the smallest stored value that is saturated: `saturation_dn`, rounded."""
    return math.floor(sensor.saturation_dn + 0.5)


@kernel(parallel=True)
def _take_unsaturated(stack, saturation_dn, stack_exposure_s, frames, exposure_s):
    n, h, w = stack.shape
    for y in numba.prange(h):
        fits = np.ones(w, dtype=np.bool_)
        for k in range(n):
            for x in range(w):
                fits[x] &= stack[k, y, x] < saturation_dn
        for k in range(n):
            for x in range(w):
                frames[k, y, x] = stack[k, y, x] if fits[x] else frames[k, y, x]
        for x in range(w):
            if fits[x]:
                exposure_s[y, x] = stack_exposure_s


def _key(seed: int, *stream: int) -> np.uint64:
    """Return a hash of seed and stream; similar seeds or streams have unrelated hashes."""
    return np.random.SeedSequence(seed, spawn_key=stream).generate_state(1, np.uint64)[0]


@kernel()
def _mix(z: np.uint64) -> np.uint64:
    """Mix 64 bits by the finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel()
def _polar(bits: np.uint64):
    """Return radius and angle for two normal numbers (Box and Muller, 1958) from 64 random bits.

    Each of the two uniform numbers has 32 bits and is never 0.
    """
    u = (np.float64(bits >> np.uint64(32)) + 0.5) * 2.0**-32
    v = (np.float64(bits & np.uint64(0xFFFFFFFF)) + 0.5) * 2.0**-32
    return math.sqrt(-2.0 * math.log(u)), 2.0 * math.pi * v


class _Shot(NamedTuple):
    """A sensor at one exposure time: fields of `SensorSpec`, scale, and keys of random streams."""

    scale: float
    dark_e: float
    full_well_e: float
    read_noise_e: float
    gain: float
    offset_dn: float
    max_dn: int
    prnu: float
    dsnu_e: float
    key: np.uint64
    fpn_key: np.uint64


@kernel(parallel=True)
def _expose(radiance, background, frames, shot):
    n, pixels = radiance.shape
    read_noise_e = shot.read_noise_e
    step = np.uint64(0x9E3779B97F4A7C15)
    for pixel in numba.prange(pixels):
        pixel_scale, pixel_offset_dn = shot.scale, shot.offset_dn + 0.5
        if shot.prnu > 0 or shot.dsnu_e > 0:
            radius, angle = _polar(_mix(shot.fpn_key + np.uint64(pixel) * step))
            pixel_scale *= max(1.0 + shot.prnu * radius * math.cos(angle), 0.0)
            pixel_offset_dn += shot.gain * shot.dsnu_e * radius * math.sin(angle)
        for k in range(n):
            mean_e = (radiance[k, pixel] + background[pixel]) * pixel_scale + shot.dark_e
            counter = np.uint64(k) * np.uint64(pixels) + np.uint64(pixel)
            bits = _mix(shot.key + counter * step)
            radius, angle = _polar(bits)
            first = radius * math.cos(angle)
            if mean_e < EXACT_POISSON_BELOW_E:
                counted_e = np.float64(_poisson(mean_e, _mix(bits)))
                signal_e = min(counted_e, shot.full_well_e) + read_noise_e * first
            elif mean_e + 7.0 * math.sqrt(mean_e) < shot.full_well_e:
                # No draw reaches the well (32 bits end at 6.8 sigma), so one draw is enough.
                signal_e = mean_e + math.sqrt(mean_e + read_noise_e * read_noise_e) * first
            else:
                counted_e = min(mean_e + math.sqrt(mean_e) * first, shot.full_well_e)
                signal_e = counted_e + read_noise_e * radius * math.sin(angle)
            dn = math.floor(shot.gain * signal_e + pixel_offset_dn)
            frames[k, pixel] = min(max(dn, 0), shot.max_dn)


@kernel()
def _poisson(mean: float, bits: np.uint64) -> int:
    """Return a Poisson number by inversion of the distribution function at one uniform number."""
    u = (np.float64(bits >> np.uint64(11)) + 0.5) * 2.0**-53
    k, probability = 0, math.exp(-mean)
    cumulative = probability
    while u > cumulative and k < 1000:  # Only rounding at u near 1 can reach the bound.
        k += 1
        probability *= mean / k
        cumulative += probability
    return k
