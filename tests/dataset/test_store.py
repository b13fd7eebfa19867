"""The dataset folder after crashes, full disks, and other runs and configurations."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.dataset.write import store as store_module


def content(out: Path, *, timings: bool = True):
    files = {
        str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()
    }
    if not timings:
        for name in [name for name in files if name.endswith("manifest.json")]:
            manifest = json.loads(files[name])
            files[name] = {key: value for key, value in manifest.items() if key != "timings"}
    return files


def fail_after(monkeypatch, writes, error):
    """Make a write fail in its middle after the given number of complete writes."""
    real, count = store_module._write, iter(range(10**6))

    def write(path, pieces, *, to_disk):
        if next(count) < writes:
            return real(path, pieces, to_disk=to_disk)
        path.write_bytes(b"".join(pieces)[:10])
        raise error

    monkeypatch.setattr(store_module, "_write", write)


@pytest.mark.parametrize("writes", [0, 7, 47])
def test_a_crash_while_writing_leaves_no_scene(opened, samples, tmp_path, monkeypatch, writes):
    with opened(tmp_path / "out") as store:
        before = content(store.out)
        with monkeypatch.context() as patch:
            fail_after(patch, writes, KeyboardInterrupt())
            with pytest.raises(KeyboardInterrupt):
                store.write(0, [samples[0]])
        assert store.finished() == set()
        assert content(store.out) == before
        store.write(0, [samples[0]])
        assert store.finished() == {0}


def test_all_files_except_masks_are_synced_before_the_scene_folder_is_renamed(
    opened, samples, tmp_path, monkeypatch
):
    """Otherwise a power cut after the rename would leave a finished scene with empty files."""
    out, at_sync = tmp_path / "out", {}
    real = os.fsync

    def fsync(descriptor):
        state = os.fstat(descriptor)
        at_sync[state.st_ino] = state.st_size, (out / "train/000000").exists()
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    with opened(out) as store:
        store.write(0, [samples[0]])
        store.finish([0])
    files = [path for path in out.rglob("*") if path.is_file() and path.name != ".lock"]
    masks = [path for path in files if path.parent.name.startswith("mask")]
    assert len(masks) > 3 and len(files) - len(masks) > 10
    for path in set(files) - set(masks):
        size, renamed = at_sync[path.stat().st_ino]
        assert size == path.stat().st_size, path
        assert not (renamed and "000000" in path.relative_to(out).parts), path
    assert at_sync[(out / "train").stat().st_ino][1]  # The folder had the scene's new name.


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_the_error_for_a_full_disk_names_folder_free_space_and_remedy(
    opened, samples, tmp_path, monkeypatch, number
):
    with opened(tmp_path / "out") as store:
        store.write(3, [samples[3]])
        before = content(store.out)
        fail_after(monkeypatch, 5, OSError(number, os.strerror(number)))
        with pytest.raises(DatasetError) as caught:
            store.write(0, [samples[0]])
        assert str(store.out) in str(caught.value)
        assert "GiB free" in str(caught.value)
        assert "free space" in str(caught.value)
        assert "run the same command again; finished scenes are kept" in str(caught.value)
        with pytest.raises(DatasetError, match="same command again"):
            fail_after(monkeypatch, 0, OSError(number, os.strerror(number)))
            store.finish([3])
        assert content(store.out) == before


@pytest.mark.slow
def test_a_small_disk_becomes_full_without_a_partial_scene(opened, samples, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=700k", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("mounting a tmpfs needs root")
    try:
        out = disk / "out"
        with opened(out) as store, pytest.raises(DatasetError, match="No space left"):
            for scene_id in range(100):
                store.write(scene_id, [samples[0]])
        finished = sorted(store.finished())
        assert finished == list(range(len(finished))) != []
        assert {path.name for path in (out / "train").iterdir()} == {
            f"{scene_id:06d}" for scene_id in finished
        }
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_runs_with_and_without_a_restart_give_the_same_files(
    opened, samples, another_time, tmp_path, dataset
):
    out = tmp_path / "out"
    with opened(out) as store:
        store.write(3, [samples[3]])
    (out / "train" / ".tmp-000000-dead" / "rgb").mkdir(parents=True)
    (out / "train" / ".tmp-000000-dead" / "rgb" / "000000.png").write_bytes(b"half")
    (out / ".tmp-train_coco.json-dead").write_bytes(b"half")
    with opened(out) as store:
        assert store.finished() == {3}
        store.write(0, [another_time(samples[0])])
        store.finish([0, 3])
    assert content(out, timings=False) == content(dataset, timings=False)


def test_a_changed_configuration_is_refused_and_its_changed_key_named(
    opened, dataset, tmp_path, parts, rig
):
    out = shutil.copytree(dataset, tmp_path / "out")
    before = content(out)
    heavy = (replace(parts[0], density_kg_m3=801.0), parts[1])
    narrow = replace(rig, far_m=0.9)
    for changed, where in [
        ({"config": {"rig": "test", "bin": {"size_m": [0.4, 0.31]}}}, r"config\.bin\.size_m\[1\]"),
        ({"config": {"rig": "test"}}, r"config\.bin .*null here"),
        ({"seed": 8}, r"seed \(7 there, 8 here\)"),
        ({"depth_scale_mm": 0.05}, "depth_scale_mm"),
        ({"parts": heavy}, r"parts\[0\]\.content"),
        ({"rig": narrow}, r"rig\.far_m"),
    ]:
        with pytest.raises(DatasetError, match=where) as caught:
            opened(out, **changed)
        assert "choose another folder" in str(caught.value)
    assert content(out) == before
    opened(out).close()


def test_a_folder_of_other_files_is_refused_and_unchanged(opened, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(DatasetError, match=r"not empty .* thesis\.txt.* another folder"):
        opened(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(DatasetError, match="is a file"):
        opened(tmp_path / "thesis.txt")


def test_a_damaged_claim_is_refused(opened, dataset, tmp_path):
    out = shutil.copytree(dataset, tmp_path / "out")
    (out / "graycast.json").write_text("{")
    with pytest.raises(DatasetError, match=r"graycast\.json cannot be read"):
        opened(out)


def test_a_second_run_is_refused_until_the_first_ends(opened, tmp_path):
    out = tmp_path / "out"
    with opened(out):
        with pytest.raises(DatasetError, match="another run is writing"):
            opened(out)
    opened(out).close()


@pytest.mark.parametrize("lost", ["models", "camera.json", "train"])
def test_a_run_killed_while_opening_is_continued(opened, samples, tmp_path, lost):
    """`graycast.json` comes first, so everything else may be missing."""
    out = tmp_path / "out"
    opened(out).close()
    before = content(out)
    target = out / lost
    shutil.rmtree(target) if target.is_dir() else target.unlink()
    opened(out).close()
    assert content(out) == before
    assert (out / "train").is_dir()


def test_an_existing_scene_is_not_overwritten(opened, samples, tmp_path):
    with opened(tmp_path / "out") as store:
        store.write(0, [samples[0]])
        before = content(store.out)
        with pytest.raises(DatasetError, match="000000 exists already: remove it"):
            store.write(0, [samples[3]])
        assert content(store.out) == before


def test_the_split_is_refused_while_scenes_are_missing(opened, samples, tmp_path):
    with opened(tmp_path / "out") as store:
        store.write(3, [samples[3]])
        with pytest.raises(DatasetError, match=r"scenes \[0, 5\] are not finished"):
            store.finish([0, 3, 5])
        assert not (store.out / "train_coco.json").exists()


def test_scene_folders_have_the_permissions_of_other_folders(opened, samples, tmp_path):
    umask = os.umask(0o022)
    try:
        with opened(tmp_path / "out") as store:
            store.write(0, [samples[0]])
            modes = {path.stat().st_mode & 0o777 for path in store.out.rglob("*")}
    finally:
        os.umask(umask)
    assert modes == {0o755, 0o644}


def test_an_output_folder_that_cannot_be_made_is_named(opened, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match=r"file/out .*Not a directory"):
        opened(tmp_path / "file" / "out")


_KILLED_RUN = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from prisms import box_part, build_sample, make_rig, wedge_part
from graycast.dataset.write.store import open_store
parts, rig = (box_part(), wedge_part()), make_rig()
samples = {0: build_sample(0, parts=parts, rig=rig), 3: build_sample(3, parts=parts, rig=rig)}
print("ready", flush=True)
config = {"rig": "test", "bin": {"size_m": [0.4, 0.3]}}
with open_store(
    Path(sys.argv[1]), config=config, seed=7, parts=parts, rig=rig, depth_scale_mm=0.02
) as store:
    for scene_id in set(samples) - store.finished():
        store.write(scene_id, [samples[scene_id]])
    store.finish(samples)
"""


@pytest.mark.slow
def test_runs_killed_at_random_moments_give_the_same_dataset(dataset, tmp_path):
    out, delay_s = tmp_path / "out", np.random.default_rng(2).uniform(0.0, 0.12, 10)
    command = [sys.executable, "-c", _KILLED_RUN, str(out), str(Path(__file__).parent)]
    for wait_s in delay_s:
        with subprocess.Popen(command, stdout=subprocess.PIPE) as run:
            run.stdout.readline()
            time.sleep(wait_s)
            run.send_signal(signal.SIGKILL)
    subprocess.run(command, check=True, capture_output=True)
    assert content(out) == content(dataset)
