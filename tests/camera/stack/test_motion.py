"""A camera that was moved during the stack is named, with the frame and the distance."""

import re
from dataclasses import replace

import numpy as np
import pytest
from backends import slow

from graycast.camera.stack import decode_stack
from graycast.camera.stack.motion import StackMotion, stack_motion
from graycast.camera.stack.white_sums import white_sums
from graycast.rig.pattern import gray, gray_phase, multi_frequency

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save

BOTH = ("column", "row")
CODES = {
    "gray": gray(128, 96, inverses=True),
    "gray and phase": gray_phase(128, 96, axes=BOTH, steps=3, inverses=True),
    "three frequencies": multi_frequency(128, 96, axes=BOTH),
}
LOOK = Look(squares=0.3, gain=0.05)


def moved(stack, at, x_px, y_px):
    """Return a stack whose camera was bumped before frame `at`."""
    late = np.roll(stack[at:], (y_px, x_px), axis=(1, 2))
    return np.concatenate([stack[:at], late])


def motions(warnings):
    pattern = r"the picture moved by (\S+) px between pictures (\d+) and (\d+) "
    return [m.groups() for m in (re.match(pattern, w) for w in warnings) if m]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gray", slow("gray and phase"), slow("three frequencies")])
@pytest.mark.parametrize(("x_px", "y_px"), [(2, 1), slow(-10, 3)])
def test_a_bump_between_columns_and_rows_causes_only_its_own_warning(name, x_px, y_px, tmp_path):
    """Oracle: the whole pixels by which the frames of the rows were shifted."""
    code = CODES[name]
    at = next(k for k, frame in enumerate(code.frames) if frame.axis == "row")
    stack = moved(shoot_cluttered(code, LOOK), at, x_px, y_px)
    warnings = decode_stack(save(tmp_path, describe(code), stack)).warnings
    assert len(warnings) == 1
    ((length, before, after),) = motions(warnings)
    assert float(length) == pytest.approx(np.hypot(x_px, y_px), abs=0.06)
    assert (int(before), int(after)) == (at, at + 1)  # counted from 1


def test_a_bump_between_a_pattern_and_its_inverse_is_warned_of_once():
    code = CODES["gray"]
    stack = moved(shoot_cluttered(code, LOOK), 9, 2, 0)  # frame 8 is a pattern, 9 its inverse
    (jump,) = stack_motion(white_sums(stack, code, 255.0)).jumps
    assert 7 <= jump.before <= 8 < 9 <= jump.after <= 10
    assert jump.x_px == pytest.approx(2.0, abs=0.15)
    assert abs(jump.y_px) < 0.15


@pytest.mark.slow
def test_a_bump_is_distinguished_from_a_steady_motion():
    """Oracle: 1 px to the right for each white sum, and once 3 px down."""
    code = CODES["gray"]
    stack = shoot_cluttered(code, LOOK)
    for k in range(16):
        stack[k] = np.roll(stack[k], (3 * (k >= 10), k // 2), axis=(0, 1))
    pairs = stack[:16]
    first = replace(code, frames=code.frames[:16])
    motion = stack_motion(white_sums(pairs, first, 255.0))
    (jump,) = motion.jumps
    assert (jump.before, jump.after) == (9, 10)
    assert jump.y_px == pytest.approx(3.0, abs=0.1)
    assert motion.steady_px == pytest.approx(7.0, abs=0.3)


def to_and_fro(pair):
    return 2 * (pair // 2 % 2)


def second_half(pair):
    return max(pair - 7, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("place_px", "extent_px"), [(to_and_fro, 2), (second_half, 7)])
def test_a_camera_that_moves_during_half_of_the_stack_causes_a_warning(
    place_px, extent_px, tmp_path
):
    """Seven of the 14 motions are 0, so the median does not show which half is usual.

    Oracle: the whole pixels by which the pairs of pattern and inverse were shifted.
    """
    code = CODES["gray"]
    stack = shoot_cluttered(code, LOOK)
    stack = np.array([np.roll(frame, place_px(k // 2), axis=1) for k, frame in enumerate(stack)])
    (warning,) = decode_stack(save(tmp_path, describe(code), stack)).warnings
    named_px = re.search(r"not evenly: its places are up to (\S+) px apart", warning)
    assert float(named_px[1]) == pytest.approx(extent_px, abs=0.1)


@pytest.mark.parametrize("name", CODES)
def test_noise_and_changing_exposure_are_not_taken_for_motion(name):
    """Each frame has another brightness, as from bulbs that warm up."""
    code = CODES[name]
    stack = shoot_cluttered(code, Look(squares=0.3, gain=0.3, read_dn=2.0))
    fading = np.linspace(1, 0.75, len(stack))[:, None, None]
    motion = stack_motion(white_sums(np.rint(stack * fading).astype(np.uint8), code, 255.0))
    assert motion == StackMotion()


@pytest.mark.slow
def test_fringes_from_a_nonlinear_projector_are_not_taken_for_motion():
    """Pictures have the square root of the light, so pairs and steps do not add up to white."""
    for code in CODES.values():
        stack = shoot_cluttered(code, Look(squares=0.3, blur_px=0.7))
        bent = np.rint(255 * np.sqrt(stack / 255)).astype(np.uint8)
        motion = stack_motion(white_sums(bent, code, 255.0))
        assert motion == StackMotion()
