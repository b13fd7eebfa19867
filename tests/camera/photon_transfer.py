"""Photon transfer: a sensor measured from its own flat fields, as a camera laboratory does it.

Only pictures are evaluated. The description of the sensor is used to take them, for the number of
stored bits, and to choose exposures; all results are fitted.

Source: EMVA Standard 1288, release 4.0, linear model, with the exposure time varied.

Not measured: linearity error, spectral sensitivity, defect pixels and quantum efficiency, since the
light is known in electrons and not in photons.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from graycast.camera.sensor import SensorSpec, expose

LINEAR_SHARE = 0.7  # share of saturation up to which EMVA 1288 fits the gain
OVEREXPOSURE = 1.2  # share of saturation of the last level
LIGHT = 1.0  # [W sr^-1 m^-2]
SHORTEST_S, DOUBLINGS = 1e-6, 32  # the exposures tried for saturation, up to about an hour


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotonTransfer:
    """Measured parameters of a sensor whose converter reaches beyond its well.

    `full_well_e` is where the response stops. `saturation_capacity_e` is EMVA's: the signal of
    greatest variance. Near its well a sensor clips the brightest electrons first, so this is lower
    by about 3 sigma of the photon noise.
    """

    gain_dn_per_e: float
    read_noise_e: float
    full_well_e: float
    saturation_capacity_e: float
    dark_current_e_s: float
    dsnu_e: float
    prnu: float
    offset_dn: float


def photon_transfer(
    sensor: SensorSpec,
    *,
    seed: int,
    levels: int = 60,
    side_px: int = 256,
    stack: int = 64,
    longest_dark_s: float = 10.0,
) -> PhotonTransfer:
    """Measure a sensor with flat fields.

    Args:
        seed: the seed of the noise of all pictures.
        levels: exposure times, evenly spaced from nearly dark to beyond saturation; EMVA asks for
            50 or more.
        side_px: side of the square pictures; the variances are known to `sqrt(2) / side_px`.
        stack: pictures averaged for the fixed pattern.
        longest_dark_s: longest exposure with which the dark current is measured.
    """
    bench = _Bench(sensor=sensor, side_px=side_px, rng=np.random.default_rng(seed))
    saturating_s = bench.saturating_exposure_s()
    times_s = np.linspace(0.0, OVEREXPOSURE, levels + 1)[1:] * saturating_s
    mean_dn, variance_dn2 = np.transpose([bench.pair(time_s) for time_s in times_s])
    dark_dn, dark_dn2 = bench.pair(times_s[0], radiance=0.0)
    signal_dn = mean_dn - dark_dn
    linear = times_s <= LINEAR_SHARE * saturating_s
    gain = _slope_through_zero(signal_dn[linear], variance_dn2[linear] - max(dark_dn2, 1 / 12))
    dsnu_dn, prnu = bench.fixed_pattern(times_s[0], 0.5 * saturating_s, stack)
    dark_dn_s, offset_dn = bench.dark_line(longest_dark_s)
    return PhotonTransfer(
        gain_dn_per_e=gain,
        read_noise_e=math.sqrt(dark_dn2 - 1 / 12) / gain,
        full_well_e=float(signal_dn[-1]) / gain,
        saturation_capacity_e=float(signal_dn[variance_dn2.argmax()]) / gain,
        dark_current_e_s=dark_dn_s / gain,
        dsnu_e=dsnu_dn / gain,
        prnu=prnu,
        offset_dn=offset_dn,
    )


def _slope_through_zero(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Fit `y = slope x` by least squares."""
    return float(x @ y / (x @ x))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Bench:
    """A sensor in front of an evenly lit sphere that can be switched off."""

    sensor: SensorSpec
    side_px: int
    rng: np.random.Generator

    def flats(
        self, exposure_s: float, count: int, *, radiance: float = LIGHT
    ) -> UInt8[np.ndarray, "count side side"] | UInt16[np.ndarray, "count side side"]:
        light = np.full((count, self.side_px, self.side_px), radiance, dtype=np.float32)
        seed = int(self.rng.integers(2**63))
        return expose(light, None, self.sensor, exposure_s=exposure_s, seed=seed).frames

    def pair(self, exposure_s: float, *, radiance: float = LIGHT) -> tuple[float, float]:
        """Return mean and temporal variance of a pair, whose difference has no fixed pattern."""
        first, second = self.flats(exposure_s, 2, radiance=radiance).astype(np.float64)
        return float(first.mean() + second.mean()) / 2, float((first - second).var()) / 2

    def saturating_exposure_s(self) -> float:
        """Return the exposure at which the line through half of the range reaches its end."""
        quick = replace(self, side_px=64)  # means only, which few pixels give precisely enough
        times_s = [SHORTEST_S * 2**k for k in range(DOUBLINGS)]
        dark_dn = quick.pair(times_s[0], radiance=0.0)[0]
        mean_dn = [quick.pair(time_s)[0] for time_s in times_s]
        share = (np.array(mean_dn) - dark_dn) / (max(mean_dn) - dark_dn)
        last = int(np.flatnonzero(share < 0.6)[-1])
        return times_s[last] / float(share[last])

    def dark_line(self, longest_s: float) -> tuple[float, float]:
        """Return slope [DN/s] and start [DN] of the dark signal over the exposure time."""
        times_s = np.linspace(0.0, longest_s, 9)[1:]
        mean_dn = np.array([self.pair(time_s, radiance=0.0)[0] for time_s in times_s])
        free = mean_dn < 0.5 * self.sensor.saturation_dn
        slope, start = np.polyfit(times_s[free], mean_dn[free], 1)
        return float(slope), float(start)

    def fixed_pattern(self, dark_s: float, half_s: float, stack: int) -> tuple[float, float]:
        """Return DSNU [DN] and PRNU [share]: spatial deviation, dark and half full.

        The temporal noise left in the averages is subtracted; the result is 0 if nothing remains.
        """
        dark_dn, dark_dn2 = _spatial(self.flats(dark_s, stack, radiance=0.0))
        half_dn, half_dn2 = _spatial(self.flats(half_s, stack))
        prnu = math.sqrt(max(half_dn2 - dark_dn2, 0.0)) / (half_dn - dark_dn)
        return math.sqrt(max(dark_dn2, 0.0)), prnu


def _spatial(flats: np.ndarray) -> tuple[float, float]:
    """Return mean and spatial variance of averaged pictures, without the temporal variance left."""
    temporal = flats.var(axis=0, ddof=1, dtype=np.float64).mean() / len(flats)
    average = flats.mean(axis=0, dtype=np.float64)
    return float(average.mean()), float(average.var(ddof=1) - temporal)
