"""A setting that is declared once serves both the Python value and the file."""

import json
import math
import pickle
import time
import tracemalloc
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from graycast.base.errors import ArgumentError, ConfigError, GraycastError
from graycast.base.sections import changes_of, section_of
from graycast.base.settings import (
    Positive,
    Settings,
    check_fields,
    parse_yaml,
    read_settings,
    setting_description,
)
from graycast.camera.decode import DecodeSpec, FilterSpec
from graycast.camera.faults import FaultSpec
from graycast.camera.rig_file.own import OpticsModel, RigModel
from graycast.camera.rig_file.scanner_sections import ScannerSections
from graycast.camera.scanner import ExposureSpec
from graycast.camera.sensor import SensorSpec
from graycast.camera.stack.description import DecodeSection as StackSection
from graycast.cell.config import Config, StoreSection, load_config
from graycast.rig.pattern import CodeSpec

CONFIGS = Path(__file__).resolve().parents[2] / "configs"

SPECS = {
    "code": CodeSpec,
    "exposure": ExposureSpec,
    "sensor": SensorSpec,
    "decode": DecodeSpec,
    "filters": FilterSpec,
    "faults": FaultSpec,
}


@dataclass(frozen=True, kw_only=True)
class Lens:
    width_px: Annotated[int, Field(ge=1, description="Image width.")]
    pupil_m: Annotated[float, Field(ge=0, lt=1)] = 0.0
    focus_m: Positive = math.inf
    zones_m: tuple[Positive, ...] = (1.0,)
    name: str = "lens"

    def __post_init__(self):
        check_fields(self)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"width_px": 0},
            r"^width_px is 0: it should be greater than or equal to 1 \(Image width\)$",
        ),
        ({"width_px": 3.0}, "^width_px is 3.0: it should be a valid integer"),
        ({"pupil_m": 1.0}, "^pupil_m is 1.0: it should be less than 1$"),
        ({"pupil_m": math.nan}, "^pupil_m is nan: it should be a finite number$"),
        ({"pupil_m": "0.1"}, "^pupil_m is '0.1': it should be a valid number$"),
        ({"focus_m": -math.inf}, "^focus_m is -inf: it should be"),
        ({"zones_m": (1.0, 0.0)}, r"^zones_m is \(1.0, 0.0\): it should be greater than 0$"),
    ],
)
def test_a_value_that_violates_its_field_s_annotation_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(Lens(width_px=4), **change)


def test_a_section_of_a_file_has_the_limits_and_defaults_of_its_class():
    section = section_of(
        Lens, "Lens", module=__name__, about="A lens.", base=Settings, more={"name": None}
    )
    assert section(width_px=4).model_dump() == {
        "width_px": 4, "pupil_m": 0.0, "focus_m": None, "zones_m": (1.0,)
    }  # fmt: skip
    with pytest.raises(ArgumentError, match="width_px"):
        section()
    for wrong in ({"width_px": 0}, {"pupil_m": 1.0}, {"focus_m": math.inf}, {"name": "x"}):
        with pytest.raises(ArgumentError, match=next(iter(wrong))):
            section(**{"width_px": 4} | wrong)
    assert section.model_json_schema()["properties"]["width_px"]["description"] == "Image width."


def test_every_key_is_optional_in_a_section_of_changes():
    section = changes_of(Lens, "Lens", module=__name__, about="What differs of a lens.")
    assert set(section().model_dump().values()) == {None}
    assert section(pupil_m=0.5).model_dump(exclude_none=True) == {"pupil_m": 0.5}
    with pytest.raises(ArgumentError, match="less than 1"):
        section(pupil_m=1.0)


def just_outside(schema):
    """Return numbers that are just outside the limits in a property's JSON Schema."""
    for option in schema.get("anyOf", [schema]):
        number = int if option.get("type") == "integer" else float
        for limit, off in (("minimum", -1), ("maximum", 1)):
            if limit in option:
                yield number(option[limit] + off)
        for limit in ("exclusiveMinimum", "exclusiveMaximum"):
            if limit in option:
                yield number(option[limit])


def test_settings_read_from_a_file_can_be_pickled():
    """Workers receive the configuration by pickle, which finds a class by its module and name."""
    config = load_config(CONFIGS / "demo.yaml")
    assert pickle.loads(pickle.dumps(config)) == config
    lens = Lens(width_px=4)
    assert pickle.loads(pickle.dumps(lens)) == lens  # Its focus has another infinity object.
    for section in (OpticsModel, RigModel, StackSection):
        assert pickle.loads(pickle.dumps(section)) is section


@pytest.mark.parametrize("name", SPECS)
def test_values_beyond_the_limits_of_a_file_are_refused_even_in_python(name):
    """This includes the fields that had other limits in files: pixel_pitch_m, wavelength_m."""
    spec, limits = SPECS[name](), 0
    properties = type(getattr(ScannerSections(), name)).model_json_schema()["properties"]
    assert list(properties) == [field.name for field in fields(spec)]
    for key, schema in properties.items():
        for wrong in just_outside(schema):
            limits += 1
            with pytest.raises(ValueError, match=rf"\b{key}\b"):
                replace(spec, **{key: wrong})
    assert limits > 2


def laughs(levels, line):
    """Return a document whose last key expands to ten to the power of `levels` words."""
    rows = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    rows += [line.format(k=k, aliases=", ".join([f"*a{k - 1}"] * 10)) for k in range(1, levels)]
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (laughs(10, "a{k}: &a{k} [{aliases}]"), "stand for more than 1,000,000 characters"),
        (laughs(10, "a{k}: &a{k} {{x: [{aliases}]}}"), "stand for more than"),
        (
            "a0: &a0 {b: 1}\n"
            + "".join(
                f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 10)}]}}\n" for k in range(1, 10)
            ),
            "stand for more than",
        ),
        ("a: &a '" + 2000 * "x" + "'\nb: [" + 1000 * "*a, " + "]\n", "stand for more than"),
        ("a: &a [1, *a]\n", "an alias stands inside of what it repeats"),
        ("a: &a {b: {c: *a}}\n", "an alias stands inside of what it repeats"),
    ],
    ids=["lists", "mappings", "merges", "a long text", "a list in itself", "a mapping in itself"],
)
def test_yaml_aliases_that_would_fill_the_memory_are_refused_at_once(tmp_path, text, why):
    """The aliases expand to ten billion words of 700 bytes; the check takes milliseconds."""
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(ConfigError, match=why) as caught:
        read_settings(path, ScannerSections)
    seconds, bytes_ = time.process_time() - start, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "is not YAML in line" in str(caught.value) and "\n" not in str(caught.value)
    assert seconds < 0.5 and bytes_ < 10_000_000


@pytest.mark.slow
def test_yaml_files_with_ordinary_aliases_and_long_files_are_read():
    text = "a: &a {x: 1, y: [1, 2]}\nb: *a\nc: {<<: *a, x: 3}\nd: [*a, *a]\n"
    a = {"x": 1, "y": [1, 2]}
    expected = {"a": a, "b": a, "c": a | {"x": 3}, "d": [a, a]}
    assert parse_yaml(text, Path("a.yaml")) == expected
    texts = [100_000 * letter for letter in "abcdefghijkl"]
    content = parse_yaml("t: [" + ", ".join(texts) + "]", Path("t.yaml"))
    assert content["t"] == texts  # files without aliases have no limit


def test_a_key_is_described_by_its_annotation_even_inside_lists_and_unions():
    class Box(Settings):
        kind: Literal["box"]
        side_m: float = Field(description="Side of the box.")

    class Ball(Settings):
        kind: Literal["ball"]
        radius_m: float = Field(description="Radius of the ball.")

    class Shop(Settings):
        goods: list[Annotated[Box | Ball, Field(discriminator="kind")]]
        lens: changes_of(Lens, "LensChanges", module=__name__, about="A lens.") | None = None

    texts = {
        "goods.0.side_m": "Side of the box.",
        "goods.3.radius_m": "Radius of the ball.",
        "lens.width_px": "Image width.",
        "lens.depth_px": "",
        "lens.width_px.0": "Image width.",
        "power": "",
    }
    assert {key: setting_description(Shop, key) for key in texts} == texts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cont": 3}, "unknown key cont: did you mean count?"),
        ({"bin": {"inr_m": 3}}, "unknown key bin.inr_m: did you mean inner_m?"),
        ({"parts": ({"bultin": "nut"},)}, "unknown key parts.0.bultin: did you mean builtin?"),
        (
            {"sensor": {"read_noise": 1}},
            "unknown key sensor.read_noise: did you mean read_noise_e?",
        ),
        ({"count": 3, "fill": 0.5}, "the arguments: count and fill both say how many parts lie "),
        ({"seed": -1}, "seed is -1: it should be greater than or equal to 0"),
    ],
)
def test_a_wrong_keyword_gives_the_same_error_in_python_and_in_a_file(settings, message, tmp_path):
    """The two errors differ only in the name at the start and in the words for the source."""
    settings = {"parts": ({"builtin": "toothpaste"},)} | settings
    with pytest.raises(GraycastError) as script:
        Config(**settings)
    assert str(script.value).startswith(f"Config: {message}")
    assert "pydantic" not in str(script.value) and isinstance(script.value, ValueError)
    path = tmp_path / "cell.yaml"
    path.write_text(json.dumps(settings), encoding="utf-8")
    with pytest.raises(ConfigError) as file:
        load_config(path)
    same = str(file.value).replace(f"{path}: ", "Config: ").replace("the file", "the arguments")
    assert same == str(script.value)


def test_a_section_is_immutable():
    with pytest.raises(GraycastError, match=r"^StoreSection: frames cannot be set later: make a"):
        StoreSection().frames = True
