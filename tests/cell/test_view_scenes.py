"""Several rendered images of one layout show one world, and an interrupted run continues."""

import json
import os
import shutil
import signal
import time

import numpy as np
import pytest
from small_cell import content, finished, start, write_cell

from graycast.base.frames import inverse, pixel_grid, transform_points
from graycast.cell.config import load_config, resolve_quality
from graycast.cell.generate import generate, rerender, save_scene
from graycast.cell.resolve import resolve_cell
from graycast.cell.simulate import make_images, make_scene
from graycast.dataset.check.checking import validate
from graycast.dataset.read.stored import open_dataset
from graycast.rig.optics import project, rays

pytestmark = pytest.mark.slow

VIEWS = [{}, {"tilt_deg": 20, "azimuth_deg": 70}]
MOUNT = [1, 0, 0, 0.02, 0, 1, 0, 0.01, 0, 0, 1, 0, 0, 0, 0, 1]
SCANNERS = [{"name": "one", "rig": "rig.yaml"}, {"name": "two", "rig": "rig.yaml"}]


DENOISED = {"samples": 4}  # in a noisy picture, `validate` may find edges that do not exist


def cell_of(folder, *without, **sections):
    folder.mkdir(exist_ok=True)
    path = write_cell(folder, *without, render=DENOISED, **sections)
    return resolve_cell(load_config(path), folder)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    mounted = [SCANNERS[0], SCANNERS[1] | {"T_first_cam": MOUNT}]
    folder = tmp_path_factory.mktemp("views")
    return cell_of(folder, "rig", views=VIEWS, scanners=mounted)


@pytest.fixture(scope="module")
def shots(cell, mitsuba_renderer):
    return list(make_images(cell, 1, seed=3, renderer=mitsuba_renderer))


@pytest.fixture(scope="module")
def dataset(cell, tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "out"
    generate(cell, out, scenes=3, seed=3, device="cpu")
    return out


def test_depths_in_all_images_of_a_scene_agree(shots):
    """Oracle: a point that two cameras see has one position.

    Points of the first image are projected into the second image. The depth there equals the
    point's depth, or is smaller where a nearer surface hides the point. It is larger only within a
    pixel of edges.
    """
    for one in shots:
        camera, truth = one.sample.scene.rig.camera, one.sample.truth
        point = rays(camera, pixel_grid(*truth.depth_m.shape)) * truth.depth_m[..., None]
        world = transform_points(one.sample.scene.T_world_cam, point.reshape(-1, 3))
        for other in shots:
            scene = other.sample.scene
            point_cam = transform_points(inverse(scene.T_world_cam), world)
            px = np.rint(project(scene.rig.camera, point_cam)).astype(int)
            h, w = other.sample.truth.depth_m.shape
            inside = ((px >= 1) & (px < [w - 1, h - 1])).all(axis=1)
            depth = other.sample.truth.depth_m[px[inside, 1], px[inside, 0]]
            gap = depth - point_cam[inside, 2]
            assert (gap < 2e-3).mean() > 0.95  # Others: slopes one pixel aside, and edges of parts.
            assert (np.abs(gap) < 2e-3).mean() > 0.75  # The other pixels are hidden.


def test_a_mounted_scanner_s_images_are_taken_from_its_pose_on_the_first_scanner(shots):
    first, second = shots[:2], shots[2:]
    for one, other in zip(first, second, strict=True):
        T = inverse(one.sample.scene.T_world_cam) @ other.sample.scene.T_world_cam
        np.testing.assert_allclose(T, np.reshape(MOUNT, (4, 4)), atol=1e-12)


def test_images_of_a_scene_share_one_layout_and_have_independent_noise(shots):
    assert len({id(shot.sample.layout) for shot in shots}) == 1
    assert [(s.sample.sensor, s.sample.image) for s in shots] == [
        ("one", 0),
        ("one", 1),
        ("two", 0),
        ("two", 1),
    ]
    assert "drop" in shots[0].sample.manifest["timings"]
    assert "drop" not in shots[1].sample.manifest["timings"]


def test_the_first_view_equals_a_cell_without_views(shots, tmp_path, mitsuba_renderer):
    alone = make_scene(cell_of(tmp_path / "alone"), 1, seed=3, renderer=mitsuba_renderer).sample
    first = shots[0].sample
    for name in ("rgb", "gray", "modulation"):
        np.testing.assert_array_equal(getattr(first, name), getattr(alone, name))
    np.testing.assert_array_equal(first.scanner_depth.depth_m, alone.scanner_depth.depth_m)
    np.testing.assert_array_equal(first.truth.depth_m, alone.truth.depth_m)


def test_a_reused_world_gives_the_same_light_as_a_new_world(shots, cell, mitsuba_renderer):
    scene = shots[-1].sample
    mitsuba_renderer.close()  # releases the reused world
    again = mitsuba_renderer.render(
        scene.scene,
        scene.layout,
        cell.patterns(),
        quality=resolve_quality(cell.config),
        seed=scene.manifest["seeds"]["render"],
    )
    np.testing.assert_array_equal(again.radiance.pattern, shots[-1].rendering.radiance.pattern)


def test_a_list_of_one_view_gives_the_same_files_as_a_single_view(tmp_path):
    generate(cell_of(tmp_path / "a"), tmp_path / "plain", scenes=1, seed=2, device="cpu")
    listed = cell_of(tmp_path / "b", views=[{}])
    generate(listed, tmp_path / "listed", scenes=1, seed=2, device="cpu")
    plain, other = content(tmp_path / "plain"), content(tmp_path / "listed")
    differing = {name for name in plain if plain[name] != other.get(name)}
    settings_files = {"graycast.json", "README.md", "train/000000/manifest.json"}
    assert plain.keys() == other.keys()
    assert {name for name in differing if not name.startswith("card/")} <= settings_files
    one, two = (files["train/000000/manifest.json"] for files in (plain, other))
    assert {key for key in one if one[key] != two[key]} == {"config", "manifest_sha256"}


def test_a_dataset_with_several_views_is_valid_and_reproducible(cell, dataset):
    assert validate(dataset) == ()
    assert rerender(cell, dataset, 2, seed=3, device="cpu") == {}
    stored = open_dataset(dataset)
    assert [scene.scene_id for scene in stored.scenes] == [0, 1, 2]
    assert len(stored.images_of(stored.scenes[0])) == 4


def test_the_rerender_command_reports_a_changed_second_image(cell, dataset, tmp_path):
    out = shutil.copytree(dataset, tmp_path / "out")
    scene = out / "train/000001"
    shutil.copy(scene / "rgb_two/000000.png", scene / "rgb_two/000001.png")
    assert list(rerender(cell, out, 1, seed=3, device="cpu")) == ["rgb_two/000001.png"]


def test_save_scene_accepts_only_all_images_of_a_scene(cell, shots, tmp_path):
    folder = save_scene(cell, shots, tmp_path / "out")
    assert (folder / "rgb_two/000001.png").is_file()
    assert validate(tmp_path / "out") == ()
    with pytest.raises(ValueError, match="scene 1 has 4 images, 1 were given"):
        save_scene(cell, shots[0], tmp_path / "other")


def test_a_killed_run_with_views_continues_and_gives_the_same_files(dataset, tmp_path):
    folder = tmp_path / "cell"
    folder.mkdir()
    mounted = [SCANNERS[0], SCANNERS[1] | {"T_first_cam": MOUNT}]
    path = write_cell(folder, "rig", views=VIEWS, scanners=mounted, seed=3, render=DENOISED)
    out = tmp_path / "out"
    command = ("generate", path, "--out", out, "--scenes", 3, "--device", "cpu")
    with start(*command) as run:
        while finished(out) < 1 and run.poll() is None:
            time.sleep(0.02)
        os.killpg(run.pid, signal.SIGKILL)
    assert 1 <= finished(out) < 3
    with start(*command) as run:
        assert run.wait() == 0, run.stderr.read()
    same = {name: data for name, data in content(dataset).items() if name.startswith("train")}
    again = content(out)
    assert {name: again[name] for name in same} == same


@pytest.mark.parametrize("kind", ["adapted", "randomized"])
def test_a_domain_moves_all_views_of_a_scene_together(kind, tmp_path):
    """Mounted scanners stay in place on the first; frames and code maps of all are checked."""
    domain = {"kind": kind}
    cell = cell_of(
        tmp_path / "cell",
        "rig",
        domain=domain,
        views={"kind": "jitter", "count": 2, "position_m": 0.01, "rotation_deg": 1},
        scanners=[SCANNERS[0], SCANNERS[1] | {"T_first_cam": MOUNT}],
        store={"frames": True, "columns": True},
    )
    out = tmp_path / "out"
    generate(cell, out, scenes=1, seed=6, device="cpu")
    assert validate(out) == ()
    scene = out / "train/000000"
    T = {}
    for name in ("one", "two"):
        views = json.loads((scene / f"scene_camera_{name}.json").read_text())
        for number, view in views.items():
            T[name, number] = np.eye(4)
            T[name, number][:3, :3] = np.reshape(view["cam_R_w2c"], (3, 3))
            T[name, number][:3, 3] = np.array(view["cam_t_w2c"]) / 1e3
    for number in ("0", "1"):
        mounted = T["one", number] @ inverse(T["two", number])
        np.testing.assert_allclose(mounted, np.reshape(MOUNT, (4, 4)), atol=1e-9)
    assert np.abs(T["one", "0"] - T["one", "1"]).max() > 1e-3
    assert (scene / "frames_two_000001/stack.yaml").is_file()
