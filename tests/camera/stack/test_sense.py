"""Phase steps with another direction or origin are detected by the Gray code."""

import re

import numpy as np
import pytest
from backends import slow

from graycast.base.errors import ConfigError
from graycast.camera.stack import decode_stack
from graycast.rig.pattern import gray_line_shift, gray_phase

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save, small_rig, view_of, write_yaml

FOUR = gray_phase(128, 96, axes=("column", "row"), steps=4)
THREE = gray_phase(128, 96, steps=3, inverses=True)  # cells of half a period only
EIGHT = gray_phase(128, 96, period_px=32.0, steps=8)
LINE = gray_line_shift(128, 96)


def decoded(folder, code, stack, renumber=None):
    """Return the stack with each column step `k` of the scanner renamed to `renumber(k)`."""
    content = describe(code)
    for e in content["frames"]:
        if renumber and e["kind"] in ("phase", "line") and e["axis"] == "column":
            e["step"] = round(renumber(e["step"]) % e["steps"], 6) % e["steps"]
    save(folder, content, stack)
    return decode_stack(write_yaml(folder, content))


def proposal(result):
    """Return proposed and stated steps, their distance in px, and the change of positions in px."""
    (warning,) = [w for w in result.warnings if "do not fit the Gray code of the columns" in w]
    match = re.search(
        r"With step (.*) of \d+ instead of (.*) they .* within (\S+) px, .* by (\S+) px", warning
    )
    after, before = ([float(n) for n in match[k].split(", ")] for k in (1, 2))
    return after, before, float(match[3]), float(match[4])


HARD = Look(squares=0.05, shadow=0.2, indirect=0.1, gain=0.1, read_dn=1.5)
CASES = [
    slow(FOUR, -1, 0.0),
    (FOUR, -1, 1.0),
    slow(FOUR, 1, 2.0),
    (THREE, -1, 0.75),  # a sine in reverse
    slow(THREE, 1, 0.75),
    (EIGHT, 1, 1.0),
    (EIGHT, -1, 3.5),
    (LINE, -1, 0.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("code", "sign", "by"), CASES)
def test_the_warning_for_a_wrong_direction_or_origin_names_the_correct_one(
    code, sign, by, tmp_path
):
    """Oracle: the known renumbering of the file; its inverse gives the truth."""
    stack = shoot_cluttered(code, HARD)
    steps, period_px = next((f.steps, f.period_px) for f in code.frames if f.steps)
    result = decoded(tmp_path, code, stack, lambda k: sign * k + by)
    after, before, off_px, moved_px = proposal(result)
    for stated, proposed in zip(before, after, strict=True):
        true = sign * (stated - by)
        assert abs((proposed - true + steps / 2) % steps - steps / 2) <= 0.02 * steps
    assert off_px < 0.06 * period_px < moved_px
    ways = "the steps run backwards" if sign < 0 else "the steps run from another origin"
    assert any(ways in warning for warning in result.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("code", [slow(FOUR), THREE, slow(EIGHT), LINE])
def test_phases_in_the_right_direction_cause_no_warning(code, tmp_path):
    for k, look in enumerate((HARD, Look(gain=0.4, read_dn=3.0, blur_px=1.0))):
        folder = tmp_path / str(k)
        folder.mkdir()
        assert not decoded(folder, code, shoot_cluttered(code, look)).warnings


@pytest.mark.slow
def test_the_proposed_phase_steps_decode_correctly_unlike_the_stated_steps(tmp_path):
    """Oracle: the projection of the wall and the ball, for a sine in reverse with 3 steps."""
    stack = shoot_cluttered(THREE, Look())
    truth = view_of(small_rig()).column
    miss_px = {}
    for name, renumber in {
        "stated": lambda k: 0.75 - k,
        "proposed": lambda k: k,
    }.items():
        folder = tmp_path / name
        folder.mkdir()
        column = decoded(folder, THREE, stack, renumber).codes.column
        off = np.abs(column - truth)[np.isfinite(column)]
        miss_px[name] = np.median(off)
    assert miss_px["proposed"] < 0.5 < 2 < miss_px["stated"]


@pytest.mark.slow
def test_the_warning_for_a_wrong_period_says_that_no_direction_or_origin_fits(tmp_path):
    content = describe(FOUR)
    for e in content["frames"]:
        if e["kind"] == "phase" and e["axis"] == "column":
            e["period_px"] = 21.0
    save(tmp_path, content, shoot_cluttered(FOUR, Look()))
    warnings = decode_stack(write_yaml(tmp_path, content)).warnings
    assert any(
        "period 21 px" in w and "in any direction or from any origin (off by" in w for w in warnings
    )


@pytest.mark.parametrize("first", [0.25, 0.75])
def test_a_cosine_that_begins_between_two_steps_needs_fractional_steps(first, tmp_path):
    """Oracle: pictures computed from the cosine's formula, not by the code under test."""
    code = gray_phase(128, 96, steps=3)
    truth = view_of(small_rig()).column
    stack = shoot_cluttered(code, Look(indirect=0.0))
    for k, frame in enumerate(code.frames):
        if frame.kind == "phase":
            turns = truth / 16 - (frame.step + first) / 3
            share = 0.5 + 0.5 * np.cos(2 * np.pi * turns)
            stack[k] = np.clip(np.rint(8 + 170 * share), 0, 255)
    result = decoded(tmp_path, code, stack, lambda k: k + first)
    lit = (np.abs(truth - 63.5) < 63) & (np.abs(view_of(small_rig()).row - 47.5) < 47)
    off = (result.codes.column - truth)[lit]
    assert not result.warnings
    assert np.isfinite(off).mean() > 0.99
    assert np.nanmax(np.abs(off)) < 0.02  # from 0.5 DN of rounding in 3 frames of amplitude 85


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "worst"), [(3, 1 / 12), (4, 1 / 8), (8, 1 / 16)])
def test_stripes_instead_of_a_cosine_cause_the_documented_error(steps, worst, tmp_path):
    """Oracle: the formula of sharp stripes, and the error of their odd harmonics in closed form.

    Of N shifts, only harmonics next to multiples of N are left; the largest error is 1 / (4 N) for
    odd N and 1 / (2 N) for even N, half of the range in which a stripe's edge gives one position.
    """
    code = gray_phase(128, 96, period_px=32.0, steps=steps, inverses=True)
    truth = view_of(small_rig()).column
    stack = shoot_cluttered(code, Look(indirect=0.0))
    for k, frame in enumerate(code.frames):
        if frame.kind == "phase":
            stack[k] = np.where(np.cos(2 * np.pi * (truth / 32 - frame.step / steps)) > 0, 180, 8)
    lit = (np.abs(truth - 63.5) < 60) & (np.abs(view_of(small_rig()).row - 47.5) < 47)
    off = (decoded(tmp_path, code, stack).codes.column - truth)[lit]
    assert 0.8 * worst * 32 < np.nanmax(np.abs(off)) < 1.03 * worst * 32


@pytest.mark.slow
def test_no_pixel_saturates_if_the_stated_saturation_exceeds_the_camera_s_range(tmp_path):
    code = gray_phase(128, 96, steps=4)
    content = describe(code) | {"levels": {"saturation_dn": 300.0}}
    save(tmp_path, content, shoot_cluttered(code, Look(bright=1.4)))
    assert decode_stack(write_yaml(tmp_path, content)).figures.reasons["saturated"] == 0


def test_unevenly_spaced_phase_steps_of_one_period_are_refused(tmp_path):
    content = describe(FOUR)
    steps = [e for e in content["frames"] if e["kind"] == "phase" and e["axis"] == "column"]
    steps[1]["step"] = 1.5
    save(tmp_path, content, shoot_cluttered(FOUR, Look()))
    with pytest.raises(
        ConfigError, match=r"16 px are 0, 1\.5, 2, 3 of 4: all of them must differ by whole"
    ):
        decode_stack(write_yaml(tmp_path, content))
