"""A step of a period that is brighter than the others is named, with its factor."""

import re

import numpy as np
import pytest
from backends import slow

from graycast.camera.stack import decode_stack
from graycast.camera.stack.brightness import brightness_faults
from graycast.camera.stack.frame_groups import full_periods
from graycast.rig.pattern import gray_phase, micro_phase, multi_frequency

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save, small_rig, view_of

CODES = {
    "gray, 3 steps": gray_phase(128, 96, steps=3, inverses=True),
    "gray, 12 steps": gray_phase(128, 96, period_px=32.0, steps=12),
    "three frequencies, 3 steps": multi_frequency(128, 96, steps=3),
    "three frequencies, 4 steps": multi_frequency(128, 96),
    "micro phase": micro_phase(128, 96),
}
LOOK = Look(squares=0.4)


def faults(code, stack):
    lit = np.ptp(stack.astype(int), axis=0) > 60
    names = [frame.name for frame in code.frames]
    warnings = [*brightness_faults(stack, code, names, lit, 255.0)]
    return [
        (m[1], float(m[2]))
        for m in (re.match(r"\S+ \((\S+)\) is (\S+) times as bright", line) for line in warnings)
        if m
    ]


def brighter(stack, k, factor):
    stack = stack.astype(float)
    stack[k] *= factor
    return np.clip(np.rint(stack), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("factor", [slow(0.85), 1.1, slow(1.2)])
@pytest.mark.parametrize("name", CODES)
def test_a_phase_step_that_is_too_bright_is_named_with_its_factor(name, factor):
    """Oracle: the factor by which one frame of the first period was multiplied."""
    code = CODES[name]
    stack = shoot_cluttered(code, LOOK)
    period = full_periods(code)[0]
    for k in period[:: max(2, len(period) // 3)]:
        ((frame, gain),) = faults(code, brighter(stack, k, factor))
        assert frame == code.frames[k].name
        assert gain == pytest.approx(factor, abs=0.03)


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("power", [slow(1.0), 0.7, slow(1.5)])
def test_equally_bright_phase_steps_cause_no_warning(name, power):
    """A nonlinear response causes harmonics, which a brighter step cannot."""
    code = CODES[name]
    stack = shoot_cluttered(code, Look(squares=0.4, blur_px=0.8, indirect=0.1)) / 255
    assert faults(code, np.rint(255 * stack**power).astype(np.uint8)) == []


def test_a_partly_visible_period_causes_no_warning_about_bright_steps():
    """Less than a third of a period is visible, so mean and cosine are nearly the same."""
    code = multi_frequency(128, 96)
    stack = shoot_cluttered(code, LOOK)[:, :, 70:76]
    assert faults(code, np.rint(255 * (stack / 255) ** 1.3).astype(np.uint8)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gray, 3 steps", slow("gray, 12 steps")])
def test_a_bright_step_moves_positions_by_at_most_the_amount_in_its_warning(name, tmp_path):
    """Oracle: the projection of the wall and the ball, and the unchanged stack."""
    code = CODES[name]
    stack = shoot_cluttered(code, Look(squares=0.4, indirect=0.0, gain=0.005, read_dn=0.3))
    k = full_periods(code)[0][1]
    folders = [tmp_path / "as_it_was", tmp_path / "brighter"]
    results = []
    for folder, own in zip(folders, (stack, brighter(stack, k, 1.2)), strict=True):
        folder.mkdir()
        results.append(decode_stack(save(folder, describe(code), own)))
    assert results[0].warnings == ()
    (warning,) = results[1].warnings
    limit_px = float(re.search(r"by up to (\S+) px", warning)[1])
    off_px = np.abs(results[1].codes.column - results[0].codes.column)
    off_px = off_px[np.isfinite(view_of(small_rig()).column) & np.isfinite(off_px)]
    assert 0.6 * limit_px < np.quantile(off_px, 0.99) < 1.25 * limit_px


def test_steps_are_not_compared_in_a_stack_without_a_lit_pixel():
    """Symptom: the median of no pixels printed NumPy's warning about an empty slice."""
    code = CODES["gray, 12 steps"]
    assert faults(code, np.full((len(code.frames), 8, 8), 10, np.uint8)) == []
