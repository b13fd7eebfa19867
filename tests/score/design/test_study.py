"""A study's file: its settings and their cells, and a one-line error for each wrong file."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from metered import Metered
from small_cell import write_cell

from graycast.base.errors import ConfigError
from graycast.base.frames import transform_points
from graycast.cli import main
from graycast.rig.pair import PRESETS
from graycast.score.design import read_design, settings_of
from graycast.score.design.setting import Setting, lights_of, place_settings

CONFIGS = Path(__file__).resolve().parents[3] / "configs"


def write_study(folder: Path, *without: str, cell=None, **changes) -> Path:
    """Write a study of the small cell; `cell` changes the cell itself."""
    write_cell(folder, **(cell or {}))
    content = {
        "cell": "cell.yaml",
        "layouts": 2,
        "points": 2000,
        "codes": {"gray": {"codec": "gray"}, "phase": {"codec": "gray_phase", "period_px": 16}},
        "exposures": {"one": {"factors": [1]}, "two": {"factors": [1, 4]}},
        "sweeps": [{"distance_m": [0.6, 0.9], "tilt_deg": [0, 20]}],
    }
    record = {key: value for key, value in (content | changes).items() if key not in without}
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(record), encoding="utf-8")
    return path


def test_a_sweep_has_all_combinations_and_a_study_has_all_sweeps(tmp_path):
    sweeps = [
        {"distance_m": [0.6, 0.9], "tilt_deg": [0, 20]},
        {"rig": ["rig.yaml", "like-phoxi-m"], "baseline_m": [0.2], "code": ["gray"]},
    ]
    settings = settings_of(read_design(write_study(tmp_path, sweeps=sweeps)))
    assert [setting.name for setting in settings] == [
        "0.6m_tilt0",
        "0.6m_tilt20",
        "0.9m_tilt0",
        "0.9m_tilt20",
        "rig_baseline0.2m_gray",
        "like-phoxi-m_baseline0.2m_gray",
    ]
    assert Setting().name == "cell"


def test_scanners_of_the_shelf_are_compared_by_name(tmp_path):
    rigs = ["like-zivid-2-m70", "lab-lightcrafter-4500"]
    spec = read_design(write_study(tmp_path, sweeps=[{"rig": rigs, "resolution": ["small"]}]))
    placed = place_settings(spec, settings_of(spec))
    assert [one.cell.scene.rig.name for one in placed] == rigs
    assert [one.cell.scene.rig.camera.width_px for one in placed] == [486, 612]


@pytest.mark.slow
def test_settings_that_differ_in_code_or_exposure_share_their_light(tmp_path):
    sweeps = [
        {"distance_m": [0.6, 0.9], "code": ["gray", "phase"], "exposure": ["one", "two"]},
        {"distance_m": [0.6]},
    ]
    spec = read_design(write_study(tmp_path, sweeps=sweeps))
    lights = lights_of(place_settings(spec, settings_of(spec)))
    assert [len(group) for group in lights] == [5, 4]


def test_the_rig_is_at_the_distance_and_tilt_of_its_setting(tmp_path):
    """Oracle: the baseline's midpoint, which has the set distance and tilt from the target."""
    spec = read_design(write_study(tmp_path, sweeps=[{"distance_m": [0.8], "tilt_deg": [20]}]))
    (placed,) = place_settings(spec, settings_of(spec))
    scene = placed.cell.scene
    middle = transform_points(scene.T_world_cam, scene.rig.T_cam_proj[:3, 3] / 2)
    away = middle - [0, 0, 0.1 / 3]  # The target is at a third of the bin's height.
    assert np.linalg.norm(away) == pytest.approx(0.8)
    assert np.degrees(np.arccos(away[2] / 0.8)) == pytest.approx(20)


@pytest.mark.slow
def test_every_key_of_a_setting_changes_its_cell(tmp_path):
    sweeps = [
        {
            "rig": ["like-phoxi-m"], "resolution": ["small"], "baseline_m": [0.2],
            "distance_m": [0.7], "azimuth_deg": [90], "code": ["gray"], "exposure": ["two"],
            "bin": ["low"],
        }
    ]  # fmt: skip
    bins = {"low": {"inner_m": [0.3, 0.2, 0.05]}}
    spec = read_design(write_study(tmp_path, sweeps=sweeps, bins=bins))
    (placed,) = place_settings(spec, settings_of(spec))
    cell = placed.cell
    assert cell.scanner.rig is cell.scene.rig
    assert cell.scene.rig.baseline_m == pytest.approx(0.2)
    # Both axes meet at the target, 0.7 m from the middle of the baseline.
    assert cell.scene.rig.axes_angle_rad == pytest.approx(2 * np.arctan(0.1 / 0.7))
    assert cell.scene.rig.camera.width_px == 516
    assert cell.scanner.code.codec == "gray"
    assert cell.scanner.exposure.factors == (1, 4)
    assert cell.scene.bin.inner_m == (0.3, 0.2, 0.05)
    direction = (cell.scene.T_world_cam @ cell.scene.rig.T_cam_proj)[:3, 3]
    direction = direction - cell.scene.T_world_cam[:3, 3]
    np.testing.assert_allclose(np.abs(direction), [0, 0.2, 0], atol=1e-9)


def test_the_committed_study_compares_24_settings():
    spec = read_design(CONFIGS / "design" / "brackets.yaml")
    settings = settings_of(spec)
    assert len(settings) == 24
    assert len(place_settings(spec, settings)) == 24


def test_an_impossible_setting_is_left_out_and_named(tmp_path):
    """A sweep of distances and rigs contains impossible combinations."""
    spec = read_design(write_study(tmp_path, sweeps=[{"distance_m": [0.6, 850, 0.9]}]))
    meter = Metered()
    placed = place_settings(spec, settings_of(spec), progress=meter)
    assert [one.setting.name for one in placed] == ["0.6m", "0.9m"]
    (note,) = meter.notes
    assert note.startswith("the setting 850m: ") and note.endswith("; it is left out")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sweps": []}, ["unknown key sweps", "did you mean sweeps?"]),
        ({"sweeps": []}, ["sweeps"]),
        ({"sweeps": [{"distence_m": [0.6]}]}, ["sweeps.0.distence_m", "did you mean distance_m?"]),
        ({"sweeps": [{"distance_m": []}]}, ["sweeps.0.distance_m", "at least 1"]),
        ({"sweeps": [{"distance_m": [-1]}]}, ["sweeps.0.distance_m.0 is -1"]),
        ({"sweeps": [{"tilt_deg": [95]}]}, ["sweeps.0.tilt_deg.0 is 95", "equal to 80"]),
        ({"layouts": 0}, ["layouts is 0"]),
        (
            {"sweeps": [{"code": ["grey"]}]},
            ["names the code 'grey'", "codes has gray, phase", "add it to"],
        ),
        ({"sweeps": [{"bin": ["low"]}]}, ["names the bin 'low'", "bins has none"]),
        (
            {"sweeps": [{"rig": ["phoxi-q"]}]},
            ["study.yaml", "no rig 'phoxi-q'", f"choose one of {', '.join(PRESETS)}"],
        ),
        (
            {"sweeps": [{"distance_m": [0.6]}, {"distance_m": [0.6, 0.9]}]},
            ["the setting 0.6m comes 2 times", "remove it from one sweep, or rename a rig file"],
        ),
        (
            {"sweeps": [{"distance_m": [850]}]},
            ["the setting 850m", "0.458 to 1.118 m", "give another distance_m"],
        ),
        ({"sweeps": [{"baseline_m": [350]}]}, ["the setting baseline350m", "not in millimetres"]),
        ({"codes": {"a/b": {}}}, ["codes", "a/b"]),
        (
            {"codes": {"x": {"codec": "gray_phase", "period_px": 1}}, "sweeps": [{"code": ["x"]}]},
            ["the setting x", "code"],
        ),
    ],
)
def test_an_invalid_study_is_refused_in_one_line(tmp_path, capsys, changes, words):
    path = write_study(tmp_path, **changes)
    assert_refused(capsys, path, tmp_path / "out", words)


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ({"parts": [{"mesh": "gone.stl", "unit": "mm"}]}, ["cell.yaml", "gone.stl"]),
        ({"domain": "randomized"}, ["cell.yaml", "domain varies the scenes", "remove it"]),
        (
            {"view": {"T_world_cam": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0.8, 0, 0, 0, 1]}},
            ["the setting 0.6m_tilt0", "view.T_world_cam is the whole pose", "distance_m"],
        ),
    ],
)
def test_a_cell_unsuitable_for_studies_is_refused_in_one_line(tmp_path, capsys, cell, words):
    assert_refused(capsys, write_study(tmp_path, cell=cell), tmp_path / "out", words)


def test_a_study_without_its_cell_is_refused_in_one_line(tmp_path, capsys):
    path = write_study(tmp_path)
    (tmp_path / "cell.yaml").unlink()
    assert_refused(capsys, path, tmp_path / "out", ["cell.yaml", "no such file"])


@pytest.mark.slow
def test_a_folder_of_other_files_is_refused(tmp_path, capsys):
    path, out = write_study(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "holiday.jpg").touch()
    words = ["out", "is not empty", "holiday.jpg", "choose another folder"]
    assert_refused(capsys, path, out, words, untouched=False)
    assert {entry.name for entry in out.iterdir()} == {"holiday.jpg"}


def assert_refused(capsys, path, out, words, *, untouched=True):
    assert main(["rig", "design", str(path), "--out", str(out)]) == 1
    message = capsys.readouterr().err
    assert message.startswith("graycast: error: ") and message.count("\n") == 1, message
    assert all(word in message for word in words), message
    assert not (untouched and out.exists())


def test_the_list_shows_the_settings_without_a_scan(tmp_path, capsys):
    path = write_study(tmp_path)
    assert main(["rig", "design", str(path), "--out", str(tmp_path / "out"), "--list"]) == 0
    assert capsys.readouterr().out.split() == [
        "0.6m_tilt0", "0.6m_tilt20", "0.9m_tilt0", "0.9m_tilt20",
    ]  # fmt: skip
    assert not (tmp_path / "out").exists()


def test_paths_start_at_the_studys_own_folder(tmp_path, monkeypatch):
    pictures = {"texture": "wood.png", "roughness_map": "worn.png"}
    path = write_study(tmp_path, sweeps=[{"rig": ["rig.yaml"]}], bins={"a": {"floor": pictures}})
    monkeypatch.chdir("/")
    spec = read_design(path)
    assert spec.cell == tmp_path / "cell.yaml"
    assert spec.sweeps[0].rig == (str(tmp_path / "rig.yaml"),)
    assert spec.bins["a"].floor.files == {key: tmp_path / name for key, name in pictures.items()}
    with pytest.raises(ConfigError, match="no such file"):
        read_design(tmp_path / "gone.yaml")
