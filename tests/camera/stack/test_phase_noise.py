"""Noise of stacks that have phases only, without inverses and white frame."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.camera.stack.description import LevelsSection
from graycast.camera.stack.levels import from_means, from_steps, measure_levels
from graycast.rig.pattern import gray_phase, micro_phase, multi_frequency

from .simulated import shoot, small_rig

STEPS, MEANS, TEXTURE = "what phase steps leave", "means of periods", "texture of a period's mean"
CODES = {
    "4 steps": (multi_frequency(128, 96), STEPS),
    "5 steps": (multi_frequency(128, 96, steps=5), STEPS),
    "12 steps": (multi_frequency(128, 96, steps=12), STEPS),
    "gray, 8 steps": (gray_phase(128, 96), STEPS),
    "3 steps": (multi_frequency(128, 96, steps=3), MEANS),
    "micro, both axes": (micro_phase(128, 96, axes=("column", "row")), MEANS),
}


def alone(code):
    return replace(code, frames=tuple(f for f in code.frames if f.kind not in ("white", "black")))


def variance_dn2(levels, light_dn, offset_dn=0.02 * 255):
    return levels.floor_dn2 + levels.slope_dn * (light_dn + offset_dn - levels.offset_dn)


@pytest.mark.parametrize("gain", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("name", CODES)
def test_the_noise_is_estimated_from_phases_alone(name, gain):
    """Oracle: the simulated noise, variance 0.25 + gain * light and 1/12 of rounding. The default
    was 4 and 2 times as much for the smallest of these gains.
    """
    code, why = CODES[name]
    frames = shoot(small_rig(), alone(code), gain=gain)
    estimate = measure_levels(frames, alone(code), LevelsSection())
    assert why in estimate.source
    for light_dn in (60.0, 100.0):
        true = 0.25 + 1 / 12 + gain * light_dn
        assert variance_dn2(estimate.levels, light_dn) == pytest.approx(true, rel=0.17)


def test_the_noise_of_three_phase_steps_is_estimated_from_neighbouring_means():
    """The smoother half of the pixels is used: without texture, the result is a fifth too low."""
    code = alone(micro_phase(128, 96))
    estimate = measure_levels(shoot(small_rig(), code, gain=0.05), code, LevelsSection())
    assert TEXTURE in estimate.source
    assert 0.75 < np.sqrt(variance_dn2(estimate.levels, 80.0) / (0.25 + 1 / 12 + 0.05 * 80)) < 1.3


@pytest.mark.parametrize("power", [1.0, 1.1, 1.3, 2.0])
@pytest.mark.parametrize(("measure", "steps"), [(from_steps, 4), (from_steps, 5), (from_means, 3)])
def test_a_nonlinear_response_is_not_counted_as_noise(measure, steps, power):
    """The residual of four steps is the second harmonic: 53, 163 and 469 DN for powers of 1.1, 1.3
    and 2 if it is not subtracted.
    """
    code = alone(multi_frequency(128, 96, steps=steps))
    clean = shoot(small_rig(), code, bits=16, gain=0.0) / 65535
    noise_dn = 2.0
    noise = np.random.default_rng(4).normal(0, noise_dn, clean.shape)
    frames = np.rint(4000 * clean**power + noise + 100).astype(np.uint16)
    floor_dn2, slope_dn = measure(frames, code, 100.0, 65535.0)
    assert np.sqrt(floor_dn2 + slope_dn * 1500.0) == pytest.approx(noise_dn, rel=0.25)
