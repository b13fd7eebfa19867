"""The command for grasp labels of a dataset: it continues a run, refuses errors, and validates."""

import json
import shutil

import numpy as np
import pytest
import yaml
from small_cell import content, write_cell

from graycast.base.errors import ConfigError
from graycast.cli import main
from graycast.robot.grasp_labels import rank, read_tool

CUP = {"kind": "suction", "cup": {"radius_m": 0.008}, "length_m": 0.2, "tube_m": 0.006}


@pytest.fixture(scope="module")
def original(robots, tmp_path_factory, mitsuba_renderer):
    """Make a dataset with two scenes of a user's mesh, its configuration, and a tool's file."""
    folder = tmp_path_factory.mktemp("labels")
    assert main(["generate", str(write_cell(folder)), "--out", str(folder / "ds")]) == 0
    write_tool(folder, CUP)
    return folder


@pytest.fixture
def folder(original, tmp_path):
    shutil.copytree(original, tmp_path / "copy")
    return tmp_path / "copy"


def write_tool(folder, section):
    (folder / "tool.yaml").write_text(yaml.safe_dump({"tool": section}))


def label(folder, *more):
    options = ["--files", str(folder), "--per-instance", "6", "--simulate", "4", *more]
    return main(
        ["dataset", "grasps", str(folder / "ds"), "--tool", str(folder / "tool.yaml"), *options]
    )


def labels(folder, name="suction"):
    return {p.name: p.read_bytes() for p in (folder / "ds/grasps" / name).glob("*/*.json")}


@pytest.mark.slow
def test_valid_grasp_labels_are_written_next_to_the_scenes(folder, capsys):
    before = content(folder / "ds")
    assert label(folder) == 0
    output = capsys.readouterr().out
    assert "ROC AUC" in output and "carried out" in output
    after = content(folder / "ds")
    assert {name: after[name] for name in before} == before
    assert {name.split("/")[0] for name in after.keys() - before.keys()} == {"grasps"}
    assert main(["validate", str(folder / "ds")]) == 0
    ranking = rank(folder / "ds", "suction")
    assert ranking.scenes == 2 and ranking.simulated == 8
    assert sum(band.grips for band in ranking.bands) == 8


@pytest.mark.slow
def test_labels_do_not_depend_on_interruptions_or_the_number_of_workers(folder):
    assert label(folder) == 0
    whole = labels(folder)
    (folder / "ds/grasps/suction/train/000001.json").unlink()
    for left in (".tmp-grasps.json-dead", "train/.tmp-000001.json-dead"):  # of a killed run
        (folder / "ds/grasps/suction" / left).write_bytes(b"half")
    assert label(folder) == 0
    assert labels(folder) == whole
    assert not list(folder.rglob(".tmp-*"))
    assert label(folder, "--name", "twice", "--workers", "2") == 0
    assert labels(folder, "twice") == whole


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: (f / "tool.yaml").write_text(yaml.safe_dump({**CUP, "tube_m": 0.005})),
            "tube_m",
        ),
        (lambda f: (f / "box.stl").unlink(), "box.stl"),
    ],
)
def test_a_changed_tool_and_missing_files_are_refused(folder, change, message, capsys):
    assert label(folder, "--simulate", "0") == 0
    change(folder)
    assert label(folder, "--simulate", "0") == 1
    line = capsys.readouterr().err.strip()
    assert message in line and "\n" not in line


@pytest.mark.slow
def test_a_changed_part_is_refused(folder, capsys):
    claim = folder / "ds/graycast.json"
    manifest = json.loads(claim.read_bytes())
    manifest["config"]["parts"][0]["density_kg_m3"] = 2.0
    claim.write_text(json.dumps(manifest))
    assert label(folder) == 1
    assert (
        "has changed since the dataset was made: restore its files, or use the"
        in capsys.readouterr().err
    )
    assert not (folder / "ds/grasps").exists()


@pytest.mark.slow
def test_jaws_that_fit_no_part_write_no_label_file(folder, capsys):
    jaws = {"kind": "jaws", "jaws": {"opening_m": 0.02}}
    write_tool(folder, jaws)
    assert label(folder) == 1
    assert "fit around none of box" in capsys.readouterr().err
    assert not (folder / "ds/grasps").exists()


def test_a_tool_is_read_from_a_cell_or_from_its_section_alone(tmp_path):
    alone, cell, wrong = (tmp_path / name for name in ("alone.yaml", "cell.yaml", "wrong.yaml"))
    alone.write_text(yaml.safe_dump({key: CUP[key] for key in CUP if key != "kind"}))
    cell.write_text(yaml.safe_dump({"parts": [], "robot": {"arm": "ur5e"}, "tool": CUP}))
    assert read_tool(alone) == read_tool(cell)
    wrong.write_text(yaml.safe_dump({"tool": {**CUP, "cup": {"radius": 0.01}}}))
    with pytest.raises(ConfigError, match=r"wrong.yaml: unknown key tool.cup.radius: did you mean"):
        read_tool(wrong)
    assert np.isclose(read_tool(cell).cup.radius_m, 0.008)
