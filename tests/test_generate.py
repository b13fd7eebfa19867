"""A dataset depends on its configuration and seed alone: not on restarts, workers or accidents."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_cell import content, finished, start, write_cell

from graycast.cell import resolve_cell
from graycast.cli import main
from graycast.config import load_config
from graycast.dataset import validate
from graycast.generate import generate
from graycast.simulate import _counts


def run(cell, out, *, scenes, seed=0, workers=1):
    """`generate`; returns its summary, the scenes found at the start and the ids made, in order."""
    found, made = [], []
    summary = generate(
        cell,
        out,
        scenes=scenes,
        seed=seed,
        device="cpu",
        workers=workers,
        on_start=found.append,
        on_progress=lambda progress: made.append(progress.scene_id),
    )
    return summary, *found, made


@pytest.fixture(scope="module")
def config_file(tmp_path_factory):
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def cell(config_file):
    return resolve_cell(load_config(config_file), config_file.parent)


@pytest.fixture(scope="module")
def undisturbed(cell, tmp_path_factory):
    """Three scenes made in one go."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    summary, found, made = run(cell, out, scenes=3)
    assert (summary.written, summary.found, found, made) == (3, 0, 0, [0, 1, 2])
    return out


@pytest.fixture(scope="module")
def many(config_file, tmp_path_factory):
    """Twelve scenes made by an undisturbed command, and the seconds that it took."""
    out, begun = tmp_path_factory.mktemp("many") / "out", time.monotonic()
    with start("generate", config_file, "--out", out, "--scenes", 12) as run:
        assert run.wait() == 0, run.stderr.read()
    return out, time.monotonic() - begun


def test_what_is_made_is_a_sound_dataset(undisturbed):
    assert validate(undisturbed) == ()
    assert finished(undisturbed) == 3


def test_the_same_command_in_another_folder_gives_the_same_files(cell, undisturbed, tmp_path):
    run(cell, tmp_path / "out", scenes=3)
    assert content(tmp_path / "out") == content(undisturbed)


def test_scenes_differ_from_each_other_and_with_the_seed(cell, undisturbed, tmp_path):
    run(cell, tmp_path / "out", scenes=1, seed=1)
    pictures = [
        (folder / "train" / scene / "rgb" / "000000.png").read_bytes()
        for folder, scene in (
            (undisturbed, "000000"),
            (undisturbed, "000001"),
            (tmp_path / "out", "000000"),
        )
    ]
    assert len(set(pictures)) == 3
    poses = [
        json.loads((folder / "train/000000/scene_gt.json").read_text())["0"][0]["cam_t_m2c"]
        for folder in (undisturbed, tmp_path / "out")
    ]
    assert np.abs(np.subtract(*poses)).max() > 1.0  # millimetres


def test_running_again_writes_nothing_and_says_so(cell, undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "out")
    train = tmp_path / "out" / "train"
    before = {path: path.stat().st_mtime_ns for path in train.rglob("*")}
    summary, found, made = run(cell, tmp_path / "out", scenes=3)
    assert (summary.written, summary.found, found, made) == (0, 3, 3, [])
    assert {path: path.stat().st_mtime_ns for path in train.rglob("*")} == before
    assert content(tmp_path / "out") == content(undisturbed)


def test_more_scenes_later_are_the_scenes_of_one_go(cell, undisturbed, tmp_path):
    run(cell, tmp_path / "out", scenes=1)
    summary, found, made = run(cell, tmp_path / "out", scenes=3)
    assert (summary.written, summary.found, found, made) == (2, 1, 1, [1, 2])
    assert content(tmp_path / "out") == content(undisturbed)


def test_fewer_scenes_later_leave_all_that_are_there(cell, undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "out")
    summary, found, made = run(cell, tmp_path / "out", scenes=1)
    assert (summary.written, summary.found, found, made) == (0, 1, 1, [])
    assert content(tmp_path / "out") == content(undisturbed)


def test_a_scene_that_was_deleted_comes_back_the_same(cell, undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "train" / "000001")
    _, _, made = run(cell, tmp_path / "out", scenes=3)
    assert made == [1]
    assert content(tmp_path / "out") == content(undisturbed)


def test_a_change_of_a_mesh_under_the_same_name_is_noticed(undisturbed, tmp_path, capsys):
    shutil.copytree(undisturbed, tmp_path / "out")
    changed = write_cell(tmp_path)
    stl = bytearray((tmp_path / "box.stl").read_bytes())
    stl[:4] = b"new "  # the header, which holds no geometry
    (tmp_path / "box.stl").write_bytes(bytes(stl))
    assert main(["generate", str(changed), "--out", str(tmp_path / "out")]) == 1
    assert "differs in config.files.box.stl" in capsys.readouterr().err
    assert content(tmp_path / "out") == content(undisturbed)


def test_a_mix_drops_all_kinds_and_else_each_scene_has_one(tmp_path):
    parts = [{"mesh": "box.stl", "unit": "mm", "name": name} for name in ("a", "b", "c")]
    rng = np.random.default_rng
    for mix in (False, True):
        path = write_cell(tmp_path, parts=parts, mix=mix, count=[20, 40])
        cell = resolve_cell(load_config(path), tmp_path)
        drawn = [_counts(cell, scene_id, rng(scene_id)) for scene_id in range(300)]
        totals = {sum(counts) for counts in drawn}
        assert totals == set(range(20, 41))  # 300 draws miss one of 21 in 1e-5 of all cases
        if mix:
            assert np.mean(drawn, axis=0) == pytest.approx([10, 10, 10], rel=0.1)
        else:
            assert [np.flatnonzero(counts).tolist() for counts in drawn[:4]] == [[0], [1], [2], [0]]


# --- accidents ---------------------------------------------------------------------------------


def test_what_cannot_be_dropped_leaves_the_folder_to_others(tmp_path):
    """A folder once kept the claim of a configuration that never made a scene."""
    out = tmp_path / "out"
    narrow = {"inner_m": [0.02, 0.02, 0.1], "material": {}}
    path = write_cell(tmp_path, bin=narrow)
    with pytest.raises(ValueError, match="does not fit into a bin"):
        run(resolve_cell(load_config(path), tmp_path), out, scenes=1)
    assert {entry.name for entry in out.iterdir()} <= {".lock"}
    path = write_cell(tmp_path)
    run(resolve_cell(load_config(path), tmp_path), out, scenes=1)
    assert validate(out) == ()


def test_a_late_failure_keeps_the_finished_scenes(cell, undisturbed, tmp_path):
    def stop(progress):
        if progress.scene_id == 1:
            raise KeyboardInterrupt

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        generate(
            cell,
            out,
            scenes=3,
            seed=0,
            device="cpu",
            workers=1,
            on_start=lambda found: None,
            on_progress=stop,
        )
    assert {entry.name for entry in (out / "train").iterdir()} == {"000000", "000001"}
    _, _, made = run(cell, out, scenes=3)
    assert made == [2]
    assert content(out) == content(undisturbed)


@pytest.mark.slow
def test_two_workers_make_what_one_makes(config_file, many, tmp_path):
    out = tmp_path / "out"
    with start("generate", config_file, "--out", out, "--scenes", 12, "--workers", 2) as run:
        printed, complaint = run.communicate()
    assert (run.returncode, complaint) == (0, "")
    assert "12 scenes made, 0 were there" in printed
    assert content(out) == content(many[0])


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_ends_quietly_and_the_same_command_goes_on(config_file, many, tmp_path, workers):
    out = tmp_path / "out"
    command = ("generate", config_file, "--out", out, "--scenes", 12, "--workers", workers)
    with start(*command) as run:
        while finished(out) < 2 and run.poll() is None:
            time.sleep(0.02)
        os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all processes of the command
        begun = time.monotonic()
        _, complaint = run.communicate()
    assert run.returncode == 130
    assert complaint == "graycast: stopped; finished scenes are kept\n"
    assert time.monotonic() - begun < 10
    assert 2 <= finished(out) < 12
    assert not list(out.rglob(".tmp-*"))
    with start(*command) as run:
        assert run.wait() == 0, run.stderr.read()
    assert content(out) == content(many[0])


@pytest.mark.slow
def test_a_worker_that_dies_is_reported_with_the_remedy(config_file, many, tmp_path):
    out = tmp_path / "out"
    command = ("generate", config_file, "--out", out, "--scenes", 12, "--workers", 2)
    with start(*command) as run:
        while finished(out) < 1 and run.poll() is None:
            time.sleep(0.02)
        os.kill(workers_of(run.pid)[0], signal.SIGKILL)
        _, complaint = run.communicate()
    assert run.returncode == 1
    assert complaint.startswith("graycast: error: a worker process died")
    assert "use fewer --workers and run the same command again" in complaint
    assert complaint.count("\n") == 1
    with start(*command) as run:
        assert run.wait() == 0, run.stderr.read()
    assert content(out) == content(many[0])


def workers_of(pid):
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [
        int(child)
        for child in children
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


@pytest.mark.slow
def test_runs_killed_at_ten_random_moments_end_in_the_same_dataset(config_file, many, tmp_path):
    """`kill -9` of the whole process group: three times anywhere, then seven times at work."""
    reference, whole_s = many
    rng, out, kills = np.random.default_rng(5), tmp_path / "out", 0
    while kills < 10:
        workers = 1 + kills % 2
        command = ("generate", config_file, "--out", out, "--scenes", 12, "--workers", workers)
        with start(*command) as run:
            before = finished(out)
            while kills >= 3 and finished(out) == before and run.poll() is None:
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 0.4 if kills >= 3 else whole_s))
            if run.poll() is None:
                os.killpg(run.pid, signal.SIGKILL)
                kills += 1
            else:  # it was quicker: begin anew, so that ten kills hit
                shutil.rmtree(out)
    with start(*command) as run:
        assert run.wait() == 0, run.stderr.read()
    assert content(out) == content(reference)
    assert validate(out) == ()


_MEMORY = """
import sys, resource
from pathlib import Path
from graycast.cell import resolve_cell
from graycast.config import load_config
from graycast.cell import resolve_cell
from graycast.generate import generate
path, out = map(Path, sys.argv[1:])
def rss(progress):
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    print(pages * resource.getpagesize())
generate(
    resolve_cell(load_config(path), path.parent), out, scenes=20, seed=0, device="cpu", workers=1,
    on_start=lambda found: None, on_progress=rss,
)
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_scenes(config_file, tmp_path):
    command = [sys.executable, "-c", _MEMORY, str(config_file), str(tmp_path / "out")]
    rss = [int(line) for line in subprocess.check_output(command, text=True).split()]
    assert len(rss) == 20
    assert rss[19] <= 1.1 * rss[2]


@pytest.mark.slow
def test_after_a_full_disk_the_same_command_goes_on(config_file, many, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("mounting a small tmpfs needs root")
    command = ("generate", config_file, "--out", disk / "out", "--scenes", 12)
    try:
        with start(*command) as run:
            _, complaint = run.communicate()
        assert run.returncode == 1
        assert complaint.startswith(f"graycast: error: cannot write to {disk / 'out'} (No space")
        assert "free space and run the same command again" in complaint
        assert complaint.count("\n") == 1
        kept = finished(disk / "out")
        assert 0 < kept < 12
        assert not list(disk.rglob(".tmp-*"))
        subprocess.run(["mount", "-o", "remount,size=50m", str(disk)], check=True)
        with start(*command) as run:
            printed, complaint = run.communicate()
        assert (run.returncode, complaint) == (0, "")
        assert f"{12 - kept} scenes made, {kept} were there" in printed
        assert content(disk / "out") == content(many[0])
    finally:
        subprocess.run(["umount", str(disk)], check=True)
