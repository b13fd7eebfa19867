"""Public values: their text in one line, their help, and unknown keywords."""

import inspect
import pydoc
import re
import typing
from dataclasses import fields, is_dataclass
from functools import cache
from types import FunctionType

import numpy as np
import pytest

import graycast as gc
from graycast.base.public_value import MOST_CHARACTERS, type_text
from graycast.base.settings import Settings


def hints_of(thing):
    try:
        return typing.get_type_hints(thing)
    except NameError:  # Only type checkers import these types.
        return {}


def reachable():
    """Return each class of value that a public function takes or returns, also as a field."""
    kinds = {}

    def add(hint):
        for inner in typing.get_args(hint):
            add(inner)
        if not isinstance(hint, type) or not hint.__module__.startswith("graycast"):
            return
        if hint in kinds or not (is_dataclass(hint) or issubclass(hint, Settings)):
            return
        kinds[hint] = None
        for inner in hints_of(hint).values():
            add(inner)
        for name, member in vars(hint).items():
            plain = member.fget if isinstance(member, property) else member
            if isinstance(plain, FunctionType) and not name.startswith("_"):
                add(hints_of(plain).get("return"))

    for name in gc.__all__[1:]:
        value = None if name in TORCH else getattr(gc, name)
        add(value)
        if isinstance(value, FunctionType):
            for hint in hints_of(inspect.unwrap(value)).values():
                add(hint)
    return list(kinds)


TORCH = ("TrainSpec", "train", "detect", "load_detector", "pictures_of")
KINDS = reachable()
LONG = "a line\n" * 500
WIDE = np.zeros((900, 700))


@cache
def monster(kind, depth=3):
    """Return a value of a class, all of whose fields are far too long for a line."""
    value = object.__new__(kind)
    inner = [monster(one, depth - 1) for one in (gc.SensorSpec, gc.Config)] if depth else []
    long = (*inner, WIDE, LONG, tuple(range(999)), {LONG: LONG})
    names = [f.name for f in fields(kind)] if is_dataclass(kind) else list(kind.model_fields)
    if is_dataclass(kind):
        for k, name in enumerate(names):
            object.__setattr__(value, name, long[k % len(long)])
        return value
    return kind.model_construct(**{name: long[k % len(long)] for k, name in enumerate(names)})


def own_text(kind):
    return is_dataclass(kind) and not kind.__dataclass_params__.repr


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_repr_of_a_public_value_is_one_line(kind):
    if own_text(kind):
        assert kind.__name__ in ("SceneResult", "Shot")
        return
    text = repr(monster(kind))
    assert text.startswith(f"{kind.__name__}(") and text.endswith(")")
    assert len(text) <= MOST_CHARACTERS and "\n" not in text
    assert is_dataclass(kind) or str(monster(kind)) == text


def test_the_tests_cover_more_than_sixty_kinds_of_public_values():
    assert len(KINDS) > 60
    assert {gc.Config, gc.Cell, gc.Example, gc.DepthMap, gc.MaterialSection, gc.Scene} <= set(KINDS)


def test_the_repr_of_a_value_omits_defaults_and_can_be_evaluated_if_short():
    for value in (
        gc.SensorSpec(read_noise_e=9.5, bit_depth=8),
        gc.MaterialSection(roughness=0.4, base_color=(0.1, 0.2, 0.3)),
        gc.CodeSpec(codec="gray_phase", axes=("column",)),
        gc.PartSection(builtin="toothpaste", material=gc.MaterialSection(roughness=0.4)),
    ):
        names = {name: getattr(gc, name) for name in ("SensorSpec", "CodeSpec", "PartSection")}
        assert eval(repr(value), names | {"MaterialSection": gc.MaterialSection}) == value
    assert repr(gc.SensorSpec()) == "SensorSpec()"
    assert repr(gc.SensorSpec(bit_depth=8)) == "SensorSpec(bit_depth=8)"


def test_the_repr_of_an_array_states_its_type_and_its_shape():
    example = gc.Example(scene_id=3, depth_m=np.zeros((386, 516), np.float32))
    assert repr(example) == "Example(scene_id=3, depth_m=float32[386, 516])"


def test_the_repr_of_a_long_value_lists_the_names_of_its_fields():
    """The cell of README has hundreds of numbers; its text names its fields."""
    scanner = gc.preset("like-phoxi-m", "small")
    text = repr(scanner)
    assert len(text) <= MOST_CHARACTERS
    assert re.findall(r"(\w+)=", text)[:2] == ["rig", "code"] and "Rig(" in text


def test_the_error_for_a_misspelt_keyword_names_the_most_similar_keyword():
    with pytest.raises(
        gc.GraycastError, match=r"^SensorSpec: unknown argument read_nois_e: did you"
    ):
        gc.SensorSpec(read_nois_e=3.0)
    with pytest.raises(TypeError, match="width_px"):  # Python's own error
        gc.Code(frames=())


def test_the_help_for_a_value_has_a_line_for_each_field_with_its_unit():
    text = pydoc.plain(pydoc.render_doc(gc.SensorSpec))
    assert "FieldInfo(annotation" not in text
    for field in fields(gc.SensorSpec):
        (line,) = re.findall(rf"^ \|\s+({field.name}\b.*\(.*\): .*)$", text, re.MULTILINE)
        assert line.endswith(".")
    assert re.search(r"read_noise_e \[electrons\] \(float = 3.0\): The standard deviation", text)
    assert re.search(r"pixel_pitch_m \[m\] \(float = 3.45e-06\): The side of a pixel", text)
    assert max(map(len, text.splitlines())) < 700


def test_the_help_for_a_value_describes_arrays_in_words():
    hints = hints_of(gc.Example)
    assert type_text(hints["rgb"]) == "array of uint8 [h, w, 3] or None"
    assert type_text(hints["K"]) == "array of floats [3, 3] or None"
    assert type_text(hints["mask"]) == "array of bools [n, h, w] or None"
    assert type_text(hints["distortion"]) == "tuple of float, ... or None"


SECTIONS = sorted(
    name for name in gc.__all__ if name not in TORCH and hasattr(getattr(gc, name), "model_fields")
)


@pytest.mark.parametrize("name", SECTIONS)
def test_the_help_for_a_section_lists_its_keys_and_nothing_from_pydantic(name):
    section = getattr(gc, name)
    text = pydoc.plain(pydoc.render_doc(section))
    assert len(text.splitlines()) < 60
    assert not re.search(r"model_validate|FieldInfo|Annotated|__pydantic", text)
    lines = text.splitlines()
    for key, info in section.model_fields.items():
        (line,) = (line for line in lines if re.match(rf" \|      {key} (\[\S+\] )?\(", line))
        assert line.rstrip().endswith(info.description or ".")


def test_the_help_for_a_section_states_unit_and_default():
    text = pydoc.plain(pydoc.render_doc(gc.BinSection))
    assert "wall_m [m] (float = 0.012): The thickness of the walls in metres." in text
    config = pydoc.plain(pydoc.render_doc(gc.Config))
    assert "code (CodeSection = CodeSection()): " in config
    assert "BinSection(*, inner_m=(0.4, 0.3, 0.15), wall_m=0.012, mesh=None" in text
