"""Inverses computed from their patterns are distinguished from those that a camera took."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.camera.stack import decode_stack
from graycast.camera.stack.computed import computed_pairs
from graycast.camera.stack.description import LevelsSection
from graycast.camera.stack.frame_groups import inverse_pairs, opposite_steps
from graycast.camera.stack.levels import measure_levels
from graycast.rig.pattern import gray, multi_frequency

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save

CODES = {"inverses": gray(128, 96, inverses=True), "opposite steps": multi_frequency(128, 96)}


def pairs_of(code):
    return [*inverse_pairs(code), *opposite_steps(code)]


def computed(code, stack, whole):
    stack = stack.copy()
    for k, other in pairs_of(code):
        stack[other] = np.clip(whole - stack[k].astype(int), 0, 255)
    return stack


@pytest.mark.parametrize("name", CODES)
def test_only_inverses_that_were_computed_are_detected(name):
    code = CODES[name]
    stack = shoot_cluttered(code, Look(squares=0.3))
    white = stack.max(axis=0).astype(int) + stack.min(axis=0)
    assert computed_pairs(stack, code) == []
    assert computed_pairs(computed(code, stack, 255), code) == pairs_of(code)
    assert computed_pairs(computed(code, stack, white), code) == pairs_of(code)


def test_pictures_with_little_noise_are_not_taken_for_computed_inverses():
    """With a noise of 0.3 DN and rounding, most but not all sums equal the next one."""
    code = CODES["inverses"]
    look = Look(squares=0.3, gain=0.0, read_dn=0.3)
    assert computed_pairs(shoot_cluttered(code, look), code) == []


@pytest.mark.parametrize("name", CODES)
def test_computed_inverses_are_not_used_to_estimate_the_noise(name):
    """Symptom: 0.29 DN, the noise of rounding. Oracle: the simulated noise, or the default."""
    code = CODES[name]
    code = replace(code, frames=tuple(f for f in code.frames if f.kind not in ("white", "black")))
    stack = computed(code, shoot_cluttered(code, Look(squares=0.3, read_dn=2.0)), 255)
    estimate = measure_levels(stack, code, LevelsSection())
    assert "measured: inverses" not in estimate.source
    assert "measured: what phase steps leave" not in estimate.source
    assert estimate.levels.floor_dn2 > 0.8


@pytest.mark.slow
def test_the_warning_about_computed_inverses_names_them_and_the_loss(tmp_path):
    code = CODES["inverses"]
    stack = computed(code, shoot_cluttered(code, Look(squares=0.3)), 255)
    (warning,) = decode_stack(save(tmp_path, describe(code), stack)).warnings
    assert warning.startswith("14 of 14 pairs of pattern and inverse add up to a constant")
    assert "were computed, not taken" in warning
