"""Pictures, bits or steps in the opposite order are named in one sentence."""

import numpy as np
import pytest
from backends import slow

from graycast.base.errors import GraycastError
from graycast.camera.stack import decode_stack
from graycast.rig.pattern import gray, gray_phase, multi_frequency

from .cluttered import Look, shoot_cluttered
from .simulated import describe, save, small_rig, write_yaml

BOTH = ("column", "row")
CODES = {
    "gray": gray(128, 96, inverses=True),
    "gray and 8 steps": gray_phase(128, 96, axes=BOTH, steps=8),
    "gray and 3 steps": gray_phase(128, 96, axes=BOTH, steps=3, inverses=True),
    "half a period": gray_phase(128, 96, steps=4, inverses=True),
    "three frequencies": multi_frequency(128, 96, axes=BOTH),
    "three frequencies of 3 steps": multi_frequency(128, 96, axes=BOTH, steps=3),
}
LOOK = Look(squares=0.3)


def warnings_of(folder, name, stack, edit=lambda content: None, rig=None):
    """Return the warnings; for a refused stack, the first one, with which the error ends."""
    content = describe(CODES[name])
    save(folder, content, stack)
    edit(content)
    try:
        return decode_stack(write_yaml(folder, content), rig).warnings
    except GraycastError as error:
        return (str(error).split(" (")[-1] if "opposite" in str(error) else str(error),)


def opposite_bits(content):
    for axis in BOTH:
        bits = [e for e in content["frames"] if e["kind"] == "gray" and e["axis"] == axis]
        top = max((e["bit"] for e in bits), default=0)
        for e in bits:
            e["bit"] = top - e["bit"]


def backwards(content):
    for e in content["frames"]:
        if e["kind"] == "phase":
            e["step"] = -e["step"] % e["steps"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "gray",
        slow("gray and 3 steps"),
        slow("gray and 8 steps"),
        slow("three frequencies"),
        "three frequencies of 3 steps",  # sums of wrong frames seem to move by 28 px
    ],
)
def test_pictures_in_reverse_order_cause_one_warning(name, tmp_path):
    stack = np.ascontiguousarray(shoot_cluttered(CODES[name], LOOK)[::-1])
    (warning,) = warnings_of(tmp_path, name, stack, rig=small_rig())
    assert warning.startswith("the pictures are in the opposite order: state the files")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gray and 8 steps", slow("gray and 3 steps"), slow("gray")])
def test_gray_bits_in_reverse_order_with_a_phase_cause_one_warning(name, tmp_path):
    """Symptom: the only warning was about depth outside the working range."""
    stack = shoot_cluttered(CODES[name], LOOK)
    warnings = warnings_of(tmp_path, name, stack, opposite_bits, small_rig())
    assert len(warnings) == 2
    for axis, warning in zip(BOTH, warnings, strict=True):
        assert f"{axis}s apart, 0.0 % if all bits were in the opposite order" in warning


@pytest.mark.slow
@pytest.mark.parametrize("name", ["half a period", slow("gray and 3 steps")])
def test_reversed_steps_are_named_if_a_gray_cell_is_half_a_period(name, tmp_path):
    """Edges of half a period coincide with the phases of both directions; their change decides."""
    stack = shoot_cluttered(CODES[name], LOOK)
    warnings = warnings_of(tmp_path, name, stack, backwards)
    assert len(warnings) == len(CODES[name].axes)
    assert all("the steps run backwards" in warning for warning in warnings)


@pytest.mark.slow
def test_the_refusal_of_a_stack_without_gray_bits_names_its_reversed_steps(tmp_path):
    stack = shoot_cluttered(CODES["three frequencies"], LOOK)
    content = describe(CODES["three frequencies"])
    backwards(content)
    save(tmp_path, content, stack)
    with pytest.raises(GraycastError, match="phase steps of columns and rows run backwards"):
        decode_stack(write_yaml(tmp_path, content))
