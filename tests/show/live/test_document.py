"""The page's settings become a configuration, and a rig file for values without a key."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from graycast.base.errors import ConfigError
from graycast.camera import scanner
from graycast.camera.decode import DecodeSpec
from graycast.camera.rig_file import load_scanner
from graycast.cell.config import Config
from graycast.cell.resolve import resolve_cell
from graycast.rig.pair import preset_rig
from graycast.show.live.controls import described_controls, values_of_files
from graycast.show.live.document import Document, RigChange, changed, checked, files_of, turned_rig

WORDS = {"parts": [{"builtin": "metal_workpiece_1"}], "count": 4}


def document(**more):
    return Document(content=WORDS | more)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cell.yaml"


def test_a_value_is_set_at_its_key_and_no_other_value_changes():
    before = document(exposure={"target": 0.5})
    after = changed(before, "exposure.percentile", 90)
    assert after.content["exposure"] == {"target": 0.5, "percentile": 90}
    after = changed(after, "parts.0.material", {"roughness": 0.2})
    assert after.content["parts"] == [WORDS["parts"][0] | {"material": {"roughness": 0.2}}]
    assert before.content == WORDS | {"exposure": {"target": 0.5}}  # The old state is unchanged.
    assert changed(after, "exposure.target", None).content["exposure"] == {"percentile": 90}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("parts.1.material", {}, "the list has 1 entries"),
        ("parts.x", 1, "x is not one of them"),
        ("ambient", -1, "ambient is -1"),
        ("ambient", "much", "give a number"),
        ("rig.power", 0, "give a factor greater than 0 and at most 1000"),
        ("rig.toe_in_deg", 61, "give degrees from -60 to 60"),
        ("rig.weight", 1, "the keys are power, baseline, toe_in_deg"),
    ],
)
def test_impossible_settings_are_refused_with_a_message(key, value, message):
    with pytest.raises(ConfigError, match=message):
        changed(document(), key, value)


def test_an_invalid_configuration_is_refused_with_the_command_line_s_message(path):
    with pytest.raises(ConfigError, match=r"cell.yaml: exposure.target is 4: it should be less"):
        checked(changed(document(), "exposure.target", 4), path)
    with pytest.raises(ConfigError, match=r"unknown key expozure: did you mean exposure\?"):
        checked(changed(document(), "expozure", 4), path)


def test_ambient_light_is_a_factor_of_all_lamps_and_the_environment(path):
    lamp = {"center_m": [0.7, -0.5, 1.6], "radiance": [10.0, 20.0, 30.0]}
    turned = changed(document(light={"lamps": [lamp, lamp]}), "ambient", 3)
    light = files_of(turned, path, rig_name="rig.yaml")[0]["light"]
    assert light["environment"]["radiance"] == pytest.approx([0.6, 0.6, 0.6])  # of the default
    assert [one["radiance"] for one in light["lamps"]] == [[30.0, 60.0, 90.0]] * 2


def test_an_unchanged_configuration_is_saved_without_changes(path):
    assert files_of(document(), path, rig_name="rig.yaml") == (WORDS, None)


def test_a_changed_rig_is_saved_exactly_in_a_separate_file(path):
    turned = replace(
        document(rig="like-phoxi-m", resolution="small"),
        rig=RigChange(power=1.7, baseline=0.9, toe_in_deg=0.3),
    )
    content, rig_text = files_of(turned, path, rig_name="own.yaml")
    assert content["rig"] == "own.yaml" and "resolution" not in content
    file = path.with_name("own.yaml")
    file.write_text(rig_text)
    rig = load_scanner(file).rig
    expected = turned_rig(scanner.preset("like-phoxi-m", "small").rig, turned.rig)
    np.testing.assert_array_equal(rig.T_cam_proj, expected.T_cam_proj)
    assert rig.camera == expected.camera and rig.intensity_w_sr == expected.intensity_w_sr == 17.0
    yaml.safe_load(rig_text)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("axis", ["column", "row"])
def test_toe_in_rotates_the_axes_by_its_value_and_keeps_the_baseline(side, axis):
    """Oracle: the angle between both axes, which meet closer to the rig if the toe-in is larger."""
    rig = preset_rig("like-phoxi-m")
    half_turn = np.diag([side, side, 1.0, 1.0])  # the projector on the other side
    quarter = np.eye(4)
    if axis == "row":
        quarter[:2, :2] = [[0, -1], [1, 0]]
    about = quarter @ half_turn
    rig = replace(rig, T_cam_proj=about @ rig.T_cam_proj @ np.linalg.inv(about))
    turned = turned_rig(rig, RigChange(toe_in_deg=3.0, baseline=1.25))
    assert np.degrees(turned.axes_angle_rad - rig.axes_angle_rad) == pytest.approx(3.0, abs=1e-9)
    assert turned.baseline_m == pytest.approx(1.25 * rig.baseline_m)
    assert turned_rig(rig, RigChange()).T_cam_proj.tolist() == rig.T_cam_proj.tolist()


def test_the_slider_for_a_surface_keeps_the_roughness_map(tmp_path):
    """A control sends its whole section; its initial values include the map's name."""
    Image.fromarray(np.zeros((2, 2), dtype=np.uint8)).save(tmp_path / "worn.png")
    worn = {"roughness_map": "worn.png", "roughness": 0.4}
    parts = [{"builtin": "toothpaste", "material": worn}]
    config = Config.model_validate(
        {"parts": parts, "bin": {"material": worn}, "table": worn, "rig": "like-phoxi-m"}
    )
    cell = resolve_cell(config, tmp_path)
    early = described_controls(config, cell.scanner)["values"]
    for values, keys in (
        (early, ("bin.material", "table")),
        (values_of_files(cell), ("bin.material", "table", "parts.0.material")),
    ):
        for key in keys:
            assert values[key]["roughness_map"] == "worn.png"
            assert values[key]["roughness"] == 0.4


def test_each_control_of_a_setting_has_the_description_of_the_setting():
    """Only values that the page itself scales have no description: ambient light, and the rig."""
    config = Config.model_validate({"parts": [{"builtin": "toothpaste"}], "rig": "like-phoxi-m"})
    controls = described_controls(config, resolve_cell(config, Path()).scanner)["controls"]
    texts = {control["key"]: control["about"] for control in controls}
    (field,) = DecodeSpec.__annotations__["doubt"].__metadata__
    assert texts["decode.doubt"] == field.description
    own = {"ambient", "rig.power", "rig.toe_in_deg", "rig.baseline"}
    assert {key for key, text in texts.items() if not text} <= own
