"""A dataset depends on its configuration and seed only, not on restarts, workers or accidents."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace

import numpy as np
import pytest
from metered import Metered
from PIL import Image
from small_cell import content, finished, start, write_cell

from graycast.base.errors import DatasetError, DropError
from graycast.camera.decode import DecodeSpec, FilterSpec
from graycast.camera.faults import FaultSpec
from graycast.camera.scanner import ExposureSpec, Scanner
from graycast.camera.sensor import SensorSpec
from graycast.cell.config import load_config
from graycast.cell.engine import SceneMaker, Workers
from graycast.cell.generate import generate, read_origin, rerender
from graycast.cell.resolve import resolve_cell
from graycast.cell.simulate import counts_of
from graycast.cli import main
from graycast.dataset.check.checking import validate
from graycast.dataset.export import Options, export
from graycast.dataset.stats import dataset_statistics
from graycast.dataset.training import open_examples
from graycast.rig.pattern import CodeSpec


def run(cell, out, *, scenes, seed=0, workers=1):
    """Run `generate`; return its summary, the scenes found at the start, and the ids made."""
    meter, ids = Metered(), []
    summary = generate(
        cell,
        out,
        scenes=scenes,
        seed=seed,
        device="cpu",
        workers=Workers(count=workers),
        progress=meter,
        on_result=lambda scene: ids.append(scene.scene_id),
    )
    counts = [done for what, done, total in meter.counts if (what, total) == ("scenes", scenes)]
    assert counts == list(range(counts[0], scenes + 1 - len(summary.set_aside)))
    return summary, counts[0], ids


@pytest.fixture(scope="module")
def config_file(tmp_path_factory):
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def cell(config_file):
    return resolve_cell(load_config(config_file), config_file.parent)


@pytest.fixture(scope="module")
def undisturbed(cell, tmp_path_factory):
    """Three scenes made in one run."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    summary, count, ids = run(cell, out, scenes=3)
    assert (summary.written, summary.found, count, ids) == (3, 0, 0, [0, 1, 2])
    return out


@pytest.fixture(scope="module")
def many(config_file, tmp_path_factory):
    """Twelve scenes made by one command, and the seconds that it took."""
    out, begun = tmp_path_factory.mktemp("many") / "out", time.monotonic()
    with start("generate", config_file, "--out", out, "--scenes", 12) as run:
        assert run.wait() == 0, run.stderr.read()
    return out, time.monotonic() - begun


def test_a_generated_dataset_is_valid(undisturbed):
    assert validate(undisturbed) == ()
    assert finished(undisturbed) == 3


@pytest.mark.slow
def test_repeating_a_command_in_another_folder_makes_equal_files(cell, undisturbed, tmp_path):
    run(cell, tmp_path / "out", scenes=3)
    assert content(tmp_path / "out") == content(undisturbed)


@pytest.mark.slow
def test_scenes_differ_within_a_dataset_and_between_seeds(cell, undisturbed, tmp_path):
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools
def test_scenes_without_parts_are_pictures_of_the_empty_bin(tmp_path):
    """Seed 0 draws 1 part for scene 0 and none for scene 1; both are used like other scenes."""
    config = write_cell(tmp_path, count=[0, 1])
    out, coco = tmp_path / "out", tmp_path / "coco"
    run(resolve_cell(load_config(config), tmp_path), out, scenes=2)
    assert validate(out) == ()
    poses = [json.loads((out / f"train/00000{i}/scene_gt.json").read_text())["0"] for i in (0, 1)]
    assert [len(each) for each in poses] == [1, 0]
    export(out, coco, Options(format="coco"))
    for folder in (out, coco):
        one, none = open_examples(folder)
        assert one.mask.shape == (1, 120, 160) and one.mask.any()
        assert none.mask.shape == (0, 120, 160) and none.box_px.shape == (0, 4)
        assert none.rgb.shape == (120, 160, 3)
    assert dataset_statistics(out).instances == {1: 1, 0: 1}
    one, none = open_examples(out)
    nearer_m = (none.depth_m - one.depth_m)[one.mask[0]]
    assert nearer_m.min() > 0 and np.median(nearer_m) > 0.02  # the box is at least 30 mm high


def test_a_second_run_writes_nothing_and_says_so(cell, undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "out")
    train = tmp_path / "out" / "train"
    before = {path: path.stat().st_mtime_ns for path in train.rglob("*")}
    summary, count, ids = run(cell, tmp_path / "out", scenes=3)
    assert (summary.written, summary.found, count, ids) == (0, 3, 3, [])
    assert {path: path.stat().st_mtime_ns for path in train.rglob("*")} == before
    assert content(tmp_path / "out") == content(undisturbed)


@pytest.mark.slow
def test_scenes_added_later_equal_those_of_a_single_run(cell, undisturbed, tmp_path):
    run(cell, tmp_path / "out", scenes=1)
    summary, count, ids = run(cell, tmp_path / "out", scenes=3)
    assert (summary.written, summary.found, count, ids) == (2, 1, 1, [1, 2])
    assert content(tmp_path / "out") == content(undisturbed)


@pytest.mark.slow
def test_a_run_for_fewer_scenes_keeps_all_existing_scenes(cell, undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "out")
    summary, count, ids = run(cell, tmp_path / "out", scenes=1)
    assert (summary.written, summary.found, count, ids) == (0, 1, 1, [])
    assert content(tmp_path / "out") == content(undisturbed)


@pytest.mark.slow
def test_a_deleted_scene_is_made_again_with_the_same_files(cell, undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "train" / "000001")
    _, _, ids = run(cell, tmp_path / "out", scenes=3)
    assert ids == [1]
    assert content(tmp_path / "out") == content(undisturbed)


@pytest.mark.slow
def test_a_changed_mesh_with_the_same_name_is_noticed(undisturbed, tmp_path, capsys):
    shutil.copytree(undisturbed, tmp_path / "out")
    changed = write_cell(tmp_path)
    stl = bytearray((tmp_path / "box.stl").read_bytes())
    stl[:4] = b"new "  # the header, which has no geometry
    (tmp_path / "box.stl").write_bytes(bytes(stl))
    assert main(["generate", str(changed), "--out", str(tmp_path / "out")]) == 1
    assert "differs in config.files.box.stl" in capsys.readouterr().err
    assert content(tmp_path / "out") == content(undisturbed)


SCANNERS = {
    "code": CodeSpec(codec="gray_phase"),
    "sensor": SensorSpec(read_noise_e=3.5),
    "exposure": ExposureSpec(target=0.7),
    "decode": DecodeSpec(min_contrast=0.1),
    "filters": FilterSpec(island_px=3),
    "faults": FaultSpec(raster_px=0.1),
}


@pytest.mark.parametrize("name", SCANNERS)
def test_a_change_of_the_scanner_in_a_rig_file_is_noticed(cell, undisturbed, name):
    assert set(SCANNERS) == {field.name for field in fields(Scanner)} - {"rig"}
    other = replace(cell, scanner=replace(cell.scanner, **{name: SCANNERS[name]}))
    with pytest.raises(DatasetError, match=rf"differs in config\.scanner\.{name}\."):
        rerender(other, undisturbed, 0, seed=0, device="cpu")


def test_a_scene_has_all_kinds_of_parts_with_mix_and_one_kind_without(tmp_path):
    parts = [{"mesh": "box.stl", "unit": "mm", "name": name} for name in ("a", "b", "c")]
    rng = np.random.default_rng
    for mix in (False, True):
        path = write_cell(tmp_path, parts=parts, mix=mix, count=[20, 40])
        cell = resolve_cell(load_config(path), tmp_path)
        draws = [counts_of(cell, scene_id, rng(scene_id)) for scene_id in range(300)]
        totals = {sum(counts) for counts in draws}
        assert totals == set(range(20, 41))  # 300 draws miss one of 21 in 1e-5 of all cases
        if mix:
            assert np.mean(draws, axis=0) == pytest.approx([10, 10, 10], rel=0.1)
        else:
            assert [np.flatnonzero(counts).tolist() for counts in draws[:4]] == [[0], [1], [2], [0]]


# --- accidents ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_configuration_whose_bin_is_too_small_claims_no_folder(tmp_path):
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


@pytest.mark.slow
def test_a_stopped_run_keeps_the_finished_scenes(cell, undisturbed, tmp_path):
    def stop(result):
        if result.scene_id == 1:
            raise KeyboardInterrupt

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        generate(
            cell,
            out,
            scenes=3,
            seed=0,
            device="cpu",
            on_result=stop,
        )
    assert {entry.name for entry in (out / "train").iterdir()} == {"000000", "000001"}
    _, _, ids = run(cell, out, scenes=3)
    assert ids == [2]
    assert content(out) == content(undisturbed)


def failing(monkeypatch, wrong):
    """Raise an error for the scenes in `wrong`, this many times."""
    real = SceneMaker.make

    def make(self, scene_id):
        error, times = wrong.get(scene_id, (None, 0))
        if times:
            wrong[scene_id] = (error, times - 1)
            raise error
        return real(self, scene_id)

    monkeypatch.setattr(SceneMaker, "make", make)


@pytest.mark.slow
def test_a_scene_that_cannot_be_made_is_set_aside_and_reported(
    cell, undisturbed, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        failing(patch, {1: (DropError("no rest"), 1)})
        summary, _, ids = run(cell, out, scenes=3)
    assert ids == [0, 2]
    (aside,) = summary.set_aside
    assert (aside.scene_id, aside.tries, aside.reason) == (1, 1, "no rest")
    recorded = {"reason": "no rest", "traceback": [], "tries": 1}
    assert json.loads((out / "set_aside.json").read_text()) == {"000001": recorded}
    with monkeypatch.context() as patch:
        failing(patch, {1: (KeyboardInterrupt(), 1)})
        with pytest.raises(KeyboardInterrupt):
            run(cell, out, scenes=3)
    assert not (out / "set_aside.json").exists()  # The scene is no longer given up.
    with monkeypatch.context() as patch:
        failing(patch, {1: (DropError("no rest"), 1), 3: (KeyboardInterrupt(), 1)})
        with pytest.raises(KeyboardInterrupt):
            run(cell, out, scenes=4)
    assert json.loads((out / "set_aside.json").read_text()) == {"000001": recorded}
    run(cell, out, scenes=1)  # This run does not try the scene.
    assert json.loads((out / "set_aside.json").read_text()) == {"000001": recorded}
    summary, count, ids = run(cell, out, scenes=3)
    assert (summary.set_aside, count, ids) == ((), 2, [1])
    assert content(out) == content(undisturbed)


@pytest.mark.slow
def test_a_failing_scene_is_tried_three_times_and_reported_with_a_traceback(
    cell, undisturbed, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        failing(patch, {0: (RuntimeError("driver lost"), 2), 2: (KeyError("a bug"), 3)})
        summary, _, ids = run(cell, tmp_path / "out", scenes=3)
    assert ids == [1, 0]
    (aside,) = summary.set_aside
    assert (aside.scene_id, aside.tries, aside.reason) == (2, 3, "KeyError 'a bug'")
    assert "in make" in aside.traceback
    run(cell, tmp_path / "out", scenes=3)
    assert content(tmp_path / "out") == content(undisturbed)


def test_a_run_without_a_finished_scene_stops_early_with_the_reason(cell, tmp_path, monkeypatch):
    failing(monkeypatch, {scene_id: (DropError("no rest"), 9) for scene_id in range(100)})
    failures = []
    with pytest.raises(DropError, match="no rest"):
        generate(
            cell, tmp_path / "out", scenes=100, seed=0, device="cpu", on_failed=failures.append
        )
    assert len(failures) == 2  # The third failure is raised.
    assert {entry.name for entry in (tmp_path / "out").iterdir()} <= {".lock"}


def test_a_run_with_successful_scenes_continues_however_many_scenes_fail(
    cell, undisturbed, tmp_path, monkeypatch
):
    """Existing scenes show that the cell works: those that fail are set aside."""
    out = shutil.copytree(undisturbed, tmp_path / "out")
    failing(monkeypatch, {scene_id: (DropError("no rest"), 1) for scene_id in range(3, 9)})
    summary, count, ids = run(cell, out, scenes=9)
    assert (count, ids, [aside.scene_id for aside in summary.set_aside]) == (3, [], [*range(3, 9)])
    assert validate(out) == ()


@pytest.mark.slow
def test_rerender_reproduces_a_scene_and_names_every_changed_file(cell, undisturbed, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(undisturbed, out)
    assert rerender(cell, out, 1, seed=0, device="cpu") == {}
    scene = out / "train" / "000001"
    picture = np.array(Image.open(scene / "gray_sl" / "000000.png"))
    picture[3, 4] = (int(picture[3, 4]) + 128) % 256
    Image.fromarray(picture).save(scene / "gray_sl" / "000000.png")
    (scene / "scene_gt.json").unlink()
    manifest = json.loads((scene / "manifest.json").read_text()) | {"device": "abacus"}
    (scene / "manifest.json").write_text(json.dumps(manifest))
    assert rerender(cell, out, 1, seed=0, device="cpu") == {
        "gray_sl/000000.png": "differs in 1 of 19200 pixels, by up to 128",
        "manifest.json": "differs in device",
        "scene_gt.json": "is not stored",
    }
    with pytest.raises(DatasetError, match="000007 is not there"):
        rerender(cell, out, 7, seed=0, device="cpu")
    with pytest.raises(DatasetError, match="another configuration, which differs in seed"):
        rerender(cell, out, 1, seed=5, device="cpu")


@pytest.mark.slow
def test_the_rerender_command_needs_only_the_dataset(config_file, undisturbed, tmp_path, capsys):
    again = ["dataset", "rerender", str(undisturbed), "--scene", "1", "--device", "cpu"]
    assert main(again) == 1
    complaint = capsys.readouterr().err
    assert "the dataset was made from the files box.stl, rig.yaml: give the folder" in complaint
    assert "with --files" in complaint
    assert main([*again, "--files", str(config_file.parent)]) == 0
    assert capsys.readouterr().out.endswith("000001: the same\n")


def test_the_recorded_origin_of_a_dataset_includes_its_configuration(cell, undisturbed):
    origin = read_origin(undisturbed)
    run_keys = {"scenes", "seed"}
    assert origin.config.model_dump(exclude=run_keys) == cell.config.model_dump(exclude=run_keys)
    assert (origin.seed, set(origin.files)) == (0, {"box.stl", "rig.yaml"})


@pytest.mark.slow
def test_two_workers_make_the_same_files_as_one_worker(config_file, many, tmp_path):
    out = tmp_path / "out"
    with start("generate", config_file, "--out", out, "--scenes", 12, "--workers", 2) as run:
        printed, complaint = run.communicate()
    assert (run.returncode, complaint) == (0, "")
    assert "12 scenes made, 0 were there" in printed
    assert content(out) == content(many[0])


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_ends_a_run_that_the_same_command_continues(config_file, many, tmp_path, workers):
    out = tmp_path / "out"
    command = ("generate", config_file, "--out", out, "--scenes", 12, "--workers", workers)
    with start(*command) as run:
        while finished(out) < 1 and run.poll() is None:
            time.sleep(0.002)
        os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all processes of the command
        begun = time.monotonic()
        _, complaint = run.communicate()
    assert run.returncode == 130
    assert (
        complaint == "graycast: the command was stopped; the finished scenes are kept; "
        "run the same command again to continue\n"
    )
    assert time.monotonic() - begun < 10
    assert 1 <= finished(out) < 12
    assert not list(out.rglob(".tmp-*"))
    with start(*command) as run:
        assert run.wait() == 0, run.stderr.read()
    assert content(out) == content(many[0])


_MEMORY = """
import sys
from pathlib import Path
from graycast.cell.resolve import resolve_cell
from graycast.cell.config import load_config
from graycast.cell.generate import generate
path, out, count = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
generate(
    resolve_cell(load_config(path), path.parent), out, scenes=int(count), seed=0, device="cpu",
    on_result=lambda made: print(made.rss_bytes),
)
"""


@pytest.mark.slow
def test_memory_does_not_increase_over_500_scenes(config_file, tmp_path):
    """Resident memory of the last tenth of the scenes is compared with the second tenth."""
    command = [sys.executable, "-c", _MEMORY, str(config_file), str(tmp_path / "out"), "500"]
    rss = [int(line) for line in subprocess.check_output(command, text=True).split()]
    assert len(rss) == 500
    assert np.median(rss[450:]) <= 1.05 * np.median(rss[50:100])


@pytest.mark.slow
def test_repeating_a_command_after_a_full_disk_continues_the_dataset(config_file, many, tmp_path):
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
        done = finished(disk / "out")
        assert 0 < done < 12
        assert not list(disk.rglob(".tmp-*"))
        subprocess.run(["mount", "-o", "remount,size=50m", str(disk)], check=True)
        with start(*command) as run:
            printed, complaint = run.communicate()
        assert (run.returncode, complaint) == (0, "")
        assert f"{12 - done} scenes made, {done} were there" in printed
        assert content(disk / "out") == content(many[0])
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.slow
def test_a_configured_depth_step_is_applied_to_files_and_stated_once_per_dataset(
    config_file, tmp_path
):
    """A dataset states its step once, where rerender and a continued run read it."""
    wide = write_cell(tmp_path, store={"depth_step_mm": 0.5})
    cell = resolve_cell(load_config(wide), tmp_path)
    run(cell, tmp_path / "out", scenes=1)
    claim = json.loads((tmp_path / "out/graycast.json").read_bytes())
    assert claim["depth_scale_mm"] == 0.5
    view = json.loads((tmp_path / "out/train/000000/scene_camera.json").read_bytes())["0"]
    assert view["depth_scale"] == 0.5
    assert validate(tmp_path / "out") == ()
    assert read_origin(tmp_path / "out").config.store.depth_step_mm == 0.5
    assert rerender(cell, tmp_path / "out", 0, seed=0, device="cpu") == {}
    finer = resolve_cell(load_config(config_file), config_file.parent)
    with pytest.raises(DatasetError, match=r"depth_scale_mm \(0.5 there, 0.02 here"):
        run(finer, tmp_path / "out", scenes=1)


def test_hulls_of_distractors_are_made_before_the_workers_start(tmp_path, monkeypatch):
    distractors = {"count": [1, 2], "parts": [{"builtin": "toothpaste"}]}
    path = write_cell(tmp_path, domain={"kind": "randomized", "distractors": distractors})
    cell = resolve_cell(load_config(path), tmp_path)

    def stop(parts, **_):
        raise DropError(" and ".join(part.name for part in parts))

    monkeypatch.setattr(sys.modules["graycast.cell.engine.workers"], "prepare", stop)
    with pytest.raises(DropError, match="box and toothpaste"):
        run(cell, tmp_path / "out", scenes=1)
