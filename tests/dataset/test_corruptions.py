"""Checksums detect every silent fault; checks of form and of models detect some of them, too.

`corruptions.py` has the faults by name. The dataset is simulated, so that pictures, light and code
are what a scanner makes of a scene.
"""

import re
import shutil
from dataclasses import replace

import pytest
import yaml
from backends import slow
from corruptions import KNOWN, OF_SUMS, SUMS_ALONE, claim, manifest, reseal
from small_cell import shrunk, write_cell

from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner
from graycast.cell.config import load_config
from graycast.cell.generate import generate
from graycast.cell.resolve import resolve_cell
from graycast.cli import main
from graycast.dataset.check.checking import validate
from graycast.rig.pair import preset_rig


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Two scenes of six boxes, 320 x 240 pixels; a projector column is 4 mm of depth."""
    work = tmp_path_factory.mktemp("cell")
    path = write_cell(work, count=6)
    rig = preset_rig("paper")
    camera, projector = shrunk(rig.camera, 320, 240), shrunk(rig.projector, 512, 384)
    rig = replace(rig, name="fine", camera=camera, projector=projector)
    save_scanner(Scanner(rig=rig), work / "rig.yaml")
    generate(resolve_cell(load_config(path), work), work / "out", scenes=2, seed=0, device="cpu")
    assert validate(work / "out") == ()
    return work / "out"


@pytest.fixture
def copy(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "out")


def some(names, every):
    """Return test parameters, of which only every `every`-th is outside the slow suite."""
    return [name if k % every == 0 else slow(name) for k, name in enumerate(names)]


def test_at_least_80_faults_are_tested():
    assert len({*KNOWN, *SUMS_ALONE, *OF_SUMS}) >= 80


@pytest.mark.parametrize("fault", some([*KNOWN, *SUMS_ALONE], 20))
def test_a_changed_file_has_another_checksum(copy, fault):
    """The fast check only computes digests: it reads neither pictures nor models."""
    do = SUMS_ALONE[fault] if fault in SUMS_ALONE else KNOWN[fault][0]
    do(copy)
    problems = [problem.what for problem in validate(copy, fast=True)]
    signs = (
        "not as it was written",
        "was changed after it was written",
        "missing",
        "a copy of another",
    )
    assert any(sign in what for sign in signs for what in problems), problems


@pytest.mark.parametrize("fault", some(KNOWN, 12))
def test_form_and_models_show_a_fault_despite_recomputed_checksums(copy, fault):
    do, words = KNOWN[fault]
    do(copy)
    reseal(copy)
    problems = [problem.what for problem in validate(copy)]
    assert any(re.search(words, what) for what in problems), problems


def test_a_scene_from_another_dataset_is_detected_without_reading_pictures(copy):
    manifest(lambda m: m.update(dataset_seed=8))(copy)
    reseal(copy)
    (problem,) = validate(copy, fast=True)
    assert problem.scene == 0
    assert "differ in dataset_seed (8 there, 0 here)" in problem.what


@pytest.mark.slow
@pytest.mark.parametrize("fault", SUMS_ALONE)
def test_faults_that_the_content_does_not_show_are_detected_by_checksums(copy, fault):
    """With recomputed checksums, validation accepts these changes, so the list is correct."""
    SUMS_ALONE[fault](copy)
    assert validate(copy) != ()
    reseal(copy)
    assert validate(copy) == ()


@pytest.mark.parametrize("fault", OF_SUMS)
def test_checksums_must_exist_for_all_files(copy, fault):
    do, words = OF_SUMS[fault]
    do(copy)
    problems = [problem.what for problem in validate(copy, fast=True)]
    assert any(re.search(words, what) for what in problems), problems


@pytest.mark.parametrize("read", [["validate"], ["validate", "--fast"], ["dataset", "stats"]])
def test_a_dataset_in_another_format_is_refused_with_a_remedy(copy, capsys, read):
    claim(lambda c: c.update(format_version=2))(copy)
    assert main([*read, str(copy)]) == 1
    error = capsys.readouterr().err
    assert "format_version: 2 is of another version of Graycast, and this one reads 3" in error
    assert "or make it again" in error and error.count("\n") == 1


@pytest.mark.slow
def test_changed_file_times_and_files_of_a_file_browser_are_accepted(copy):
    manifest(lambda m: m["timings"].update(render=1e3))(copy)
    (copy / "train/000000/.DS_Store").write_bytes(b"seen")
    assert validate(copy) == ()


DARK = {
    "far": ({"view": {"distance_m": 1e9}}, "65.534 m: give a smaller view.distance_m"),
    "farther than its range": (
        {"view": {"distance_m": 5.0}},
        "so in none: .* near_m and far_m",
    ),
    "unlit": ({"exposure": {"exposure_s": 1e-300}}, r"\d+% are shadow: give a longer exposure"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", ["far", slow("farther than its range"), "unlit"])
def test_a_run_without_any_decoded_pixel_ends_with_the_reason(tmp_path, capsys, case):
    changes, words = DARK[case]
    path = write_cell(tmp_path, **changes)
    assert main(["generate", str(path), "--out", str(tmp_path / "out"), "--device", "cpu"]) == 1
    assert re.search(words, capsys.readouterr().err)
    assert not (tmp_path / "out" / "graycast.json").exists()


CELLS = {
    "phases": {"code": {"codec": "gray_phase"}},
    "merged exposures": {"exposure": {"factors": [0.1, 1.0, 6.0]}},
    "8 bits": {"sensor": {"bit_depth": 8}},
    "tilted": {"view": {"tilt_deg": 35.0, "azimuth_deg": 70.0}},
    "randomized with distractors": {"domain": "randomized", "count": 8},
    "adapted": {"domain": "adapted"},
    "frames and code maps": {"store": {"frames": True, "columns": True}},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CELLS)
def test_valid_datasets_cause_no_false_alarm(tmp_path, case):
    path = write_cell(tmp_path, **CELLS[case])
    cell = resolve_cell(load_config(path), tmp_path)
    generate(cell, tmp_path / "out", scenes=3, seed=0, device="cpu")
    assert validate(tmp_path / "out") == ()
    assert yaml.safe_load(path.read_text())["count"] in (3, 8)
