"""Two exchanged pictures of a period are named, and no other fault or remedy."""

import re
from itertools import combinations

import numpy as np
import pytest
from backends import slow

from graycast.camera.stack import decode_stack
from graycast.rig.pattern import gray_phase, multi_frequency

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save, write_yaml

HARD = Look(squares=0.05, shadow=0.2, indirect=0.1, gain=0.1, read_dn=1.5)
BOTH = ("column", "row")
CODES = {
    "three": gray_phase(128, 96, steps=3, inverses=True),
    "four": gray_phase(128, 96, axes=BOTH, steps=4),
    "five": gray_phase(128, 96, steps=5),
    "six": gray_phase(128, 96, period_px=32.0, steps=6),
    "eight": gray_phase(128, 96, period_px=32.0, steps=8),
    "twelve": gray_phase(128, 96, period_px=32.0, steps=12),
    "three frequencies": multi_frequency(128, 96, axes=BOTH),
}


def warnings_of(folder, name, one, other, stack=None):
    """Return the warnings if two steps of the columns' first period are exchanged."""
    code = CODES[name]
    content = describe(code)
    steps = [e for e in content["frames"] if e["kind"] == "phase" and e["axis"] == "column"]
    first = [e for e in steps if e["period_px"] == steps[0]["period_px"]]
    save(folder, content, shoot_cluttered(code, HARD) if stack is None else stack)
    first[one]["file"], first[other]["file"] = first[other]["file"], first[one]["file"]
    return decode_stack(write_yaml(folder, content)).warnings


def named(warning):
    """Return the pairs of steps that a warning calls exchanged."""
    steps = [int(k) for k in re.findall(r"column_phase_\w*?step(\d+) ", warning)]
    return sorted(zip(steps[::2], steps[1::2], strict=True))


CASES = [
    ("four", 0, 1),  # no warning in earlier versions
    slow("four", 2, 3),
    ("four", 1, 2),  # another origin
    slow("five", 0, 1),
    ("five", 1, 4),  # steps in reverse
    ("six", 1, 5),
    ("eight", 1, 4),  # six steps that were not equally bright
    slow("eight", 0, 2),
    slow("eight", 3, 4),
    ("twelve", 3, 4),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "one", "other"), CASES)
def test_two_exchanged_pictures_cause_only_their_own_warning(name, one, other, tmp_path):
    """Oracle: the two exchanged pictures. All other pairs of four to six steps are excluded."""
    (warning,) = warnings_of(tmp_path, name, one, other)
    assert named(warning) == [(one, other)], warning
    assert "of the columns are in a wrong order" in warning and "may be exchanged" in warning
    assert "origin" not in warning and "backwards" not in warning and "bright" not in warning


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other", "twin"), [(0, 1, (2, 3)), slow(1, 2, (0, 3))])
def test_an_exchange_without_gray_bits_is_named_with_two_pairs(one, other, twin, tmp_path):
    """Oracle: 1, 0, 2, 3 with the last two exchanged is 1 - k, a sine in reverse."""
    (warning,) = warnings_of(tmp_path, "three frequencies", one, other)
    assert named(warning) == sorted([(one, other), twin]), warning
    assert "which these pictures cannot tell apart" in warning


@pytest.mark.parametrize(
    ("name", "one", "other"), [("three", 0, 1), slow("three", 1, 2), ("four", 1, 3)]
)
def test_swapped_steps_that_look_like_a_reversed_sine_are_named_first(name, one, other, tmp_path):
    """Oracle: k and c - k differ in two of three steps, or of four if c is even."""
    (warning,) = warnings_of(tmp_path, name, one, other)
    first, second = warning.split(" may be exchanged, or ")
    assert named(first + " ") == [(one, other)]
    assert second.startswith("the steps run backwards. With step")


def test_a_copied_picture_is_reported_as_a_copy_and_not_as_an_exchange(tmp_path):
    code = CODES["eight"]
    stack = shoot_cluttered(code, HARD)
    k, other = (next(i for i, f in enumerate(code.frames) if f.step == s) for s in (1, 3))
    stack[k] = stack[other]
    warnings = warnings_of(tmp_path, "eight", 0, 0, stack)
    assert any("are the same picture" in w for w in warnings)
    assert not any("exchanged" in w for w in warnings)


@pytest.mark.slow
def test_a_bright_step_is_named_even_if_another_period_has_exchanged_pictures(tmp_path):
    """Only the period with the exchange is not checked for equal brightness."""
    code = CODES["three frequencies"]
    stack = shoot_cluttered(code, HARD).astype(float)
    k = next(i for i, f in enumerate(code.frames) if f.axis == "row" and f.step == 1)
    stack[k] *= 1.25
    stack = np.clip(np.rint(stack), 0, 255).astype(np.uint8)
    exchange, unequal = warnings_of(tmp_path, "three frequencies", 0, 1, stack)
    assert named(exchange) == [(0, 1), (2, 3)]
    assert unequal.startswith(code.frames[k].name) and "1.25 times as bright" in unequal


@pytest.mark.slow
@pytest.mark.parametrize("power", [slow(0.6), 1.8])
def test_a_nonlinear_response_neither_hides_nor_imitates_exchanged_pictures(power, tmp_path):
    code = CODES["eight"]
    stack = shoot_cluttered(code, Look(squares=0.4, blur_px=0.8, indirect=0.1)) / 255
    stack = np.rint(255 * stack**power).astype(np.uint8)
    for k, pair in enumerate([(0, 0), *list(combinations(range(8), 2))[3::13]]):
        folder = tmp_path / str(k)
        folder.mkdir()
        exchanges = [w for w in warnings_of(folder, "eight", *pair, stack) if "exchanged" in w]
        assert [named(w) for w in exchanges] == ([[pair]] if k else [])
