"""Healthy stacks of hard scenes cause no warning, and faulty ones always do."""

import pytest

from graycast.camera.stack import decode_stack
from graycast.rig.pattern import gray, gray_phase, micro_phase, multi_frequency, xor_gray

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save, write_yaml

CODES = {
    "gray": gray(128, 96),
    "gray and inverses": gray(128, 96, inverses=True),
    "xor": xor_gray(128, 96),
    "gray and phase": gray_phase(128, 96, axes=("column", "row"), steps=4),
    "three frequencies": multi_frequency(128, 96, axes=("column", "row")),
    "micro phase": micro_phase(128, 96),
}
LOOKS = {
    "dark squares": Look(squares=0.03),
    "a shadow": Look(shadow=0.4, indirect=0.12),
    "squares and a shadow": Look(squares=0.05, shadow=0.3, indirect=0.1),
    "a bare wall that flickers": Look(unlit=0.6, flicker_dn=4.0),
    "mostly a wall that flickers": Look(unlit=0.9, flicker_dn=8.0),
    "blur and grey squares": Look(squares=0.1, blur_px=1.2, indirect=0.1),
}
QUICK = [
    ("gray and inverses", "squares and a shadow"),
    ("xor", "mostly a wall that flickers"),
    ("gray and phase", "a bare wall that flickers"),
    ("micro phase", "dark squares"),
]
ALL = [
    pytest.param(code, look, marks=[] if (code, look) in QUICK else pytest.mark.slow)
    for code in CODES
    for look in LOOKS
]


def warnings_of(folder, code, stack, edit=None):
    content = describe(code)
    save(folder, content, stack)
    if edit is not None:
        edit(content)
    return decode_stack(write_yaml(folder, content)).warnings


@pytest.mark.slow
@pytest.mark.parametrize(("name", "look"), ALL)
def test_a_healthy_stack_of_a_hard_scene_causes_no_warning(name, look, tmp_path):
    code = CODES[name]
    assert not warnings_of(tmp_path, code, shoot_cluttered(code, LOOKS[look]))


@pytest.mark.slow
def test_contradictions_among_noisy_pixels_are_attributed_to_noise(tmp_path):
    code = CODES["micro phase"]
    stack = shoot_cluttered(code, Look(bright=0.05, read_dn=3.0, gain=0.3))
    (warning,) = [w for w in warnings_of(tmp_path, code, stack) if "contradict" in w]
    assert "times the noise, which may be the reason: lengthen the exposure" in warning


# --- faults, in the same hard scenes ------------------------------------------------------------


def misname(content):
    """Exchange the names of a column's bit and a row's bit."""
    swap(content, "column_bit03", "row_bit04")


def exchange(content):
    for suffix in ("", "_inverse"):
        swap(content, f"column_bit02{suffix}", f"column_bit05{suffix}")


def shift(content):
    """Give each bit the files of the next coarser one, and the coarsest those of the finest."""
    bits = [e for e in content["frames"] if e.get("axis") == "column"]
    files = [e["file"] for e in bits]
    for e, file in zip(bits, files[-2:] + files[:-2], strict=True):
        e["file"] = file


def reverse(content):
    for e in content["frames"]:
        if e.get("axis") == "column":
            e["bit"] = 6 - e["bit"]


def swap(content, one, other):
    a, b = (
        next(e for e in content["frames"] if e["file"] == f"{name}.png") for name in (one, other)
    )
    a["file"], b["file"] = b["file"], a["file"]


FAULTS = [
    (
        misname,
        "% of the well lit pixels have frames that contradict",
    ),
    (exchange, "if column_bit05 and column_bit02 were exchanged"),
    (shift, "if each bit were 1 finer, in a cycle"),
    (reverse, "if all bits were in the opposite order"),
]
FAULTY = ["dark squares", "squares and a shadow", "a bare wall that flickers"]


@pytest.mark.parametrize(
    ("edit", "says", "look"),
    [
        pytest.param(*fault, look, marks=[] if look == FAULTY[1] else pytest.mark.slow)
        for fault in FAULTS
        for look in FAULTY
    ],
)
def test_a_fault_causes_a_warning_even_in_a_hard_scene(edit, says, look, tmp_path):
    code = CODES["gray and inverses"]
    warnings = warnings_of(tmp_path, code, shoot_cluttered(code, LOOKS[look]), edit)
    assert any(says in warning for warning in warnings), warnings
