"""Exposure times chosen for the light: closed forms and laws of the bracket."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.camera.exposure import SPAN_MAX, ExposureSpec, ExposureTimes, exposure_times
from graycast.camera.sensor import SensorSpec

SENSOR = SensorSpec()
RANGE_E = (SENSOR.saturation_dn - SENSOR.offset_dn) / SENSOR.gain_dn_per_e
AUTO = ExposureSpec(auto=True)


def levels(light: float, times: ExposureTimes) -> np.ndarray:
    """Return the share of the sensor's range that a light reaches in each exposure."""
    rate_e_s = SENSOR.responsivity * light + SENSOR.dark_current_e_s
    return np.array(times.times_s) * rate_e_s / RANGE_E


def two_lights(ratio: float) -> np.ndarray:
    return np.repeat([1.0, ratio], 500).astype(np.float32)


@pytest.mark.parametrize(("ratio", "count"), [(7.9, 1), (50.0, 2), (500.0, 3), (4000.0, 4)])
def test_two_light_levels_get_the_fewest_exposures_that_their_ratio_needs(ratio, count):
    times = exposure_times(two_lights(ratio), SENSOR, AUTO)
    assert len(times.times_s) == count
    assert levels(ratio, times)[0] == pytest.approx(0.8)
    for light in (1.0, np.sqrt(ratio), ratio):
        level = levels(light, times)
        assert ((level > 0.1 - 1e-6) & (level < 0.8 + 1e-6)).any()


def test_light_of_a_single_level_gets_one_exposure_at_its_target():
    times = exposure_times(np.full(100, 3.0, np.float32), SENSOR, replace(AUTO, target=0.6))
    assert levels(3.0, times) == pytest.approx([0.6])
    assert times.reference_s == times.times_s[0]


def test_exposure_times_are_inversely_proportional_to_the_light():
    sensor = replace(SENSOR, dark_current_e_s=0.0)
    white = np.random.default_rng(0).lognormal(0, 2, 5000).astype(np.float32)
    once, brighter = (exposure_times(k * white, sensor, AUTO) for k in (1, 16))
    assert np.array(once.times_s) / 16 == pytest.approx(brighter.times_s)
    assert once.reference_s / 16 == pytest.approx(brighter.reference_s)


def test_a_few_pixels_of_mirrored_light_do_not_change_exposure_times():
    white = two_lights(50.0)
    with_mirrors = np.concatenate([white, np.array([1e6], dtype=np.float32)])
    assert exposure_times(with_mirrors, SENSOR, AUTO).times_s == pytest.approx(
        exposure_times(white, SENSOR, AUTO).times_s
    )


def test_the_number_and_the_span_of_exposures_are_limited():
    for most in (1, 2, 3, 5):
        times = exposure_times(two_lights(1e9), SENSOR, replace(AUTO, most=most)).times_s
        assert len(times) == most
        assert levels(1e9, exposure_times(two_lights(1e9), SENSOR, AUTO))[0] == pytest.approx(0.8)
        assert times[-1] / times[0] <= SPAN_MAX * (1 + 1e-9)


def test_bracketing_scaled_light_gives_the_time_of_automatic_exposure():
    white = two_lights(500.0)
    fixed = exposure_times(white, SENSOR, ExposureSpec(factors=(1.0, 4.0)))
    assert exposure_times(white, SENSOR, AUTO).reference_s == fixed.reference_s
    assert fixed.times_s == (fixed.reference_s, 4.0 * fixed.reference_s)


def test_exposing_dark_pixels_is_refused_with_a_remedy():
    with pytest.raises(ValueError, match=r"no metered pixel has light: .*exposure\.exposure_s"):
        exposure_times(np.zeros(9, np.float32), SENSOR, AUTO)
