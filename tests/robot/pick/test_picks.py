"""Whole bins of a small cell: records are consistent, and a seed always gives the same folder."""

import json
import os
import signal
import time
from dataclasses import replace

import pytest
from small_cell import shrunk, start, write_cell

from graycast.base.errors import DatasetError
from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner
from graycast.cli import main
from graycast.rig.pair import preset_rig
from graycast.robot.pick import (
    Outcome,
    load_pick_config,
    pick,
    read_episodes,
    resolve_pick_cell,
    summarize,
)
from graycast.robot.pick.results.pick_files import WORK

TOOL = {"kind": "suction", "cup": {"radius_m": 0.01}, "length_m": 0.15}


def cell_of(folder, **picking):
    """Return the small cell with a camera of 400 x 300 pixels, which suffices for poses."""
    folder.mkdir(exist_ok=True)
    path = write_cell(folder, tool=TOOL, picking={"place_m": [0.0, -0.4, 0.3]} | picking)
    rig = preset_rig("paper")
    camera, projector = shrunk(rig.camera, 400, 300), shrunk(rig.projector, 256, 192)
    finer = replace(rig, name="small", camera=camera, projector=projector)
    save_scanner(Scanner(rig=finer), folder / "rig.yaml")
    return path


def run(path, out, *options):
    return main(["robot", "pick", str(path), "--out", str(out), *map(str, options)])


def content(out):
    """Return every file except the lock and the computing times."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and path.name not in (WORK, ".lock")
    }


@pytest.fixture(scope="module")
def picks(robots, tmp_path_factory):
    folder = tmp_path_factory.mktemp("picks")
    path = cell_of(folder)
    assert run(path, folder / "out", "--bins", 2) == 0
    return path, folder / "out"


@pytest.mark.slow
def test_every_part_is_counted_and_every_attempt_is_recorded(picks):
    _, out = picks
    for episode in read_episodes(out):
        assert episode.filled == 3 == episode.taken + episode.left + episode.spilled
        folder = out / "bins" / f"{episode.bin_id:06d}"
        motion = json.loads((folder / "motion.json").read_bytes())["attempts"]
        assert len(list((folder / "pictures").iterdir())) == len(episode.attempts) == len(motion)
        before = set(range(3))
        for attempt, moved in zip(episode.attempts, motion, strict=True):
            assert attempt["outcome"] in set(map(str, Outcome))
            assert set(attempt["present"]) <= before
            assert len(attempt["T_world_part"]) == len(attempt["present"])
            before = set(attempt["present"])
            if attempt["outcome"] == "picked":
                assert attempt["part"] in before and attempt["least_factor"] >= 1
                before -= {attempt["part"]}
            # The arm ends where it releases parts, and its motion takes the recorded time.
            if moved is not None:
                assert moved["time_s"][-1] == pytest.approx(attempt["seconds"]["motion"], abs=1e-3)


@pytest.mark.slow
def test_a_robot_with_a_plain_scanner_picks_boxes(picks):
    """For three boxes with free tops, most grips hold, and picked parts are not detected again."""
    summary = summarize(read_episodes(picks[1]))
    assert summary.rate[0] >= 0.7 and summary.taken >= 5


@pytest.mark.slow
def test_a_finished_run_is_not_repeated_and_a_changed_cell_is_refused(picks, tmp_path, capsys):
    path, out = picks
    before = content(out)
    assert run(path, out, "--bins", 2) == 0
    assert content(out) == before
    assert run(path, out, "--bins", 2, "--pose", "truth") == 1
    assert "another configuration" in capsys.readouterr().err
    assert content(out) == before


@pytest.mark.slow
def test_a_wrong_calibration_makes_grips_fail(robots, tmp_path):
    """With an error of 40 mm, the tool touches nothing or another part."""
    path = cell_of(tmp_path, hand_eye_m=0.04, failures=2)
    assert run(path, tmp_path / "out", "--bins", 1) == 0
    summary = summarize(read_episodes(tmp_path / "out"))
    assert summary.picked <= 1 and summary.grips >= 1


def test_a_folder_of_other_files_is_refused(tmp_path):
    path = cell_of(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("x")
    cell = resolve_pick_cell(load_pick_config(path), tmp_path)
    with pytest.raises(DatasetError, match=r"mine\.txt"):
        pick(cell, tmp_path / "out", bins=1, seed=0)
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["mine.txt"]


@pytest.mark.slow
def test_two_workers_make_the_same_bins(picks, tmp_path):
    path, out = picks
    assert run(path, tmp_path / "two", "--bins", 2, "--workers", 2, "--threads", 1) == 0
    assert content(tmp_path / "two") == content(out)


@pytest.mark.slow
def test_a_run_that_is_killed_and_restarted_gives_the_same_bins(picks, tmp_path):
    path, out = picks
    for _ in range(2):
        running = start("robot", "pick", path, "--out", tmp_path / "out", "--bins", 2)
        time.sleep(14)
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()
    assert run(path, tmp_path / "out", "--bins", 2) == 0
    assert content(tmp_path / "out") == content(out)
