"""Test whole studies of a small cell: pairing, parallel workers and resuming."""

import json
import os
import signal
import time

import pytest
from small_cell import start
from test_study import write_study

from graycast.base.errors import DatasetError
from graycast.cli import main
from graycast.score.design import read_design, rows_of

pytestmark = pytest.mark.slow

SWEEPS = [{"distance_m": [0.6, 0.9], "code": ["gray", "phase"], "exposure": ["one"]}]


def run(path, out, *options):
    return main(["rig", "design", str(path), "--out", str(out), *map(str, options)])


def content(out):
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Return the file and the folder of a finished study."""
    folder = tmp_path_factory.mktemp("study")
    path = write_study(folder, sweeps=SWEEPS)
    assert run(path, folder / "out") == 0
    return path, folder / "out"


def test_a_study_writes_tables_plots_and_a_sentence(study, capsys):
    path, out = study
    assert run(path, out) == 0  # All results exist, so nothing is scanned again.
    printed = capsys.readouterr().out
    names = {"table.md", "table.csv", "design.json", "pareto.png", "missing.png"}
    assert names <= set(content(out))
    record = json.loads((out / "design.json").read_bytes())
    assert record["says"] in (out / "table.md").read_text()
    assert (
        printed.count(record["says"]) == 1 and "of the open surface of the parts" in record["says"]
    )
    assert "|" not in printed  # Only the file has the Markdown table.
    assert len(record["rows"]) == 4
    for row in record["rows"]:
        lost = sum(row[name] for name in ("part_shadow", "dark", "edge", "hidden_by_parts"))
        assert 0 < row["measured"] <= 1 - lost + 1e-9
        assert row["measured_low"] < row["measured"] < row["measured_high"]


def test_all_settings_are_scored_at_the_same_points_of_the_same_heaps(study):
    _, out = study
    for heap in ("000.json", "001.json"):
        points = {
            json.loads((folder / heap).read_bytes())["points"]
            for folder in (out / "settings").iterdir()
        }
        assert len(points) == 1


def test_the_result_of_a_code_does_not_depend_on_other_codes(study, tmp_path):
    """Codes share a rendering, which must not depend on the other codes of the study."""
    _, out = study
    path = write_study(tmp_path, sweeps=[{"distance_m": [0.9], "code": ["phase"]}])
    assert run(path, tmp_path / "alone") == 0
    alone, beside = (
        json.loads((folder / "000.json").read_bytes())
        for folder in (
            tmp_path / "alone/settings/0.9m_phase",
            out / "settings/0.9m_phase_one",
        )
    )
    assert alone == beside


def test_two_workers_write_the_same_files_as_one_worker(study, tmp_path):
    path, out = study
    assert run(path, tmp_path / "two", "--workers", 2, "--threads", 1) == 0
    assert content(tmp_path / "two") == content(out)


def test_a_killed_study_continues_to_the_same_results(study, tmp_path):
    path, out = study
    running = start("rig", "design", path, "--out", tmp_path / "out")
    try:
        begun = time.monotonic()
        while not list(tmp_path.glob("out/settings/*/000.json")):
            assert running.poll() is None and time.monotonic() - begun < 300
            time.sleep(0.05)
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()
    assert len(list(tmp_path.glob("out/settings/*/00?.json"))) < 8
    # If the run is killed while it writes a file, the next run must remove the partial file.
    (tmp_path / "out/settings/0.9m_phase_one/.tmp-000.json-dead").write_bytes(b"half")
    assert run(path, tmp_path / "out") == 0
    assert content(tmp_path / "out") == content(out)


def test_added_settings_and_heaps_keep_the_existing_results(tmp_path, capsys):
    path = write_study(tmp_path, layouts=1, sweeps=[{"distance_m": [0.6]}])
    assert run(path, tmp_path / "out") == 0
    first = tmp_path / "out/settings/0.6m/000.json"
    written = first.stat().st_mtime_ns
    write_study(tmp_path, layouts=2, sweeps=[{"distance_m": [0.6, 0.9]}])
    assert run(path, tmp_path / "out") == 0
    assert first.stat().st_mtime_ns == written
    assert [len(row.measured_by_heap) for row in rows_of(read_design(path), tmp_path / "out")] == [
        2,
        2,
    ]
    capsys.readouterr()
    write_study(tmp_path, wrong_m=0.001, sweeps=[{"distance_m": [0.6]}])
    assert run(path, tmp_path / "out") == 1
    message = capsys.readouterr().err
    assert (
        "measured with other values" in message and "study.wrong_m (0.005 there, 0.001" in message
    )


def test_two_runs_cannot_write_to_the_same_folder(study):
    from graycast.score.design.result_files import open_design

    _, out = study
    with open_design(out), pytest.raises(DatasetError, match="another run is writing"):
        with open_design(out):
            pass
