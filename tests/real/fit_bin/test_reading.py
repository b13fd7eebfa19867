"""Reading of views from depth files, folders, and scenes of a dataset."""

import json
import shutil

import cv2
import numpy as np
import pytest
from dataset.prisms import make_rig
from simulated_dataset import write_dataset

from graycast.base.errors import DatasetError, GraycastError
from graycast.real.depth_file import FileOptions
from graycast.real.fit_bin import read_frames, read_views
from graycast.real.fit_bin.look import Frames, light_scale
from graycast.rig.optics import Optics

OWN = Optics(width_px=40, height_px=30, fx_px=50.0, fy_px=50.0, cx_px=19.5, cy_px=14.5)
DEPTH_MM = np.full((30, 40), 900, dtype=np.uint16)
FILE_OPTIONS = FileOptions(scale_m=1e-3)


@pytest.fixture
def depth_file(tmp_path):
    depth = DEPTH_MM.copy()
    depth[0, 0] = 0
    cv2.imwrite(str(tmp_path / "a.png"), depth)
    return tmp_path / "a.png"


def test_depth_of_the_same_size_as_the_rig_uses_the_camera_of_the_rig(depth_file):
    (view,) = read_views([depth_file], options=FILE_OPTIONS, own=OWN)
    assert view.camera == OWN
    assert np.isnan(view.depth_m[0, 0])
    assert view.depth_m[1, 1] == pytest.approx(0.9)
    assert view.rgb is None


def test_a_picture_is_read_with_its_depth(depth_file, tmp_path):
    rgb = np.zeros((30, 40, 3), dtype=np.uint8)
    rgb[..., 0] = 200
    cv2.imwrite(str(tmp_path / "c.png"), rgb[..., ::-1])
    (view,) = read_views([depth_file], rgb=[tmp_path / "c.png"], options=FILE_OPTIONS, own=OWN)
    assert np.array_equal(view.rgb, rgb)
    with pytest.raises(DatasetError, match="2 colour pictures for 1 depth files"):
        read_views([depth_file], rgb=[tmp_path / "c.png"] * 2, options=FILE_OPTIONS, own=OWN)


def test_depth_of_another_camera_needs_its_intrinsics(depth_file):
    other = Optics(width_px=80, height_px=60, fx_px=50.0, fy_px=50.0, cx_px=39.5, cy_px=29.5)
    with pytest.raises(DatasetError, match="give its intrinsics"):
        read_views([depth_file], options=FILE_OPTIONS, own=other)
    K = np.array([[61.0, 0, 20.0], [0, 60.0, 15.0], [0, 0, 1]])
    (view,) = read_views([depth_file], options=FileOptions(K=K, scale_m=1e-3), own=other)
    assert np.array_equal(view.camera.K, K)
    assert not view.camera.has_distortion


def test_files_that_cannot_be_a_view_are_refused(depth_file, tmp_path):
    with pytest.raises(DatasetError, match=r"one of \.npy"):
        read_views([tmp_path / "x.jpg"], options=FILE_OPTIONS, own=OWN)
    few = np.full((30, 40), np.nan)
    few[:3] = 0.9
    np.save(tmp_path / "few.npy", few)
    with pytest.raises(DatasetError, match="depth in 120 pixels"):
        read_views([tmp_path / "few.npy"], options=FileOptions(), own=OWN)


def test_a_dataset_scene_is_read_with_its_camera_depth_and_picture(tmp_path):
    samples = write_dataset(tmp_path / "out", scene_ids=(0,))
    (view,) = read_views([tmp_path / "out/train/000000"], options=FileOptions(), own=OWN)
    assert np.array_equal(view.camera.K, make_rig().camera.K)
    own = samples[0].scanner_depth.depth_m
    assert np.array_equal(np.isnan(view.depth_m), np.isnan(own))
    assert np.nanmax(np.abs(view.depth_m - own)) <= 0.5001e-4  # half a step of 0.1 mm
    assert np.array_equal(view.rgb, samples[0].rgb)


@pytest.fixture(scope="module")
def stored_scene(tmp_path_factory):
    out = tmp_path_factory.mktemp("stored") / "out"
    write_dataset(out, scene_ids=(0,))
    return out / "train/000000"


def damaged(change):
    """Return a function that changes the only camera in the text of `scene_camera_sl.json`."""

    def of(text):
        content = json.loads(text)
        change(content["0"])
        return json.dumps(content)

    return of


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda text: text[: len(text) // 2], "Invalid JSON"),
        (lambda text: "", "Invalid JSON"),
        (lambda text: "[]", "Input should be an object"),
        (
            lambda text: text.replace('"0"', '"first"', 1),
            "the key of an image must be its number, and it needs",
        ),
        (lambda text: '{"0": null}', "0: .*needs cam_K"),
        (damaged(lambda view: view.pop("cam_K")), r"0\.cam_K: Field required"),
        (damaged(lambda view: view.pop("depth_scale")), r"0\.depth_scale: Field required"),
        (damaged(lambda view: view.update(depth_scale=0)), r"0\.depth_scale: .*than 0"),
        (damaged(lambda view: view.update(cam_K=[1.0] * 8)), r"0\.cam_K: .*at least 9"),
        (damaged(lambda view: view.update(distortion=[0.1])), r"0\.distortion: .*at least 5"),
    ],
)
def test_damaged_cameras_of_a_scene_are_named_with_their_file(stored_scene, tmp_path, damage, why):
    scene = shutil.copytree(stored_scene, tmp_path / "scene")
    path = scene / "scene_camera_sl.json"
    path.write_text(damage(path.read_text()))
    with pytest.raises(DatasetError, match=why) as caught:
        read_views([scene], options=FileOptions(), own=OWN)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_camera_without_focal_length_is_reported_with_its_picture(stored_scene, tmp_path):
    scene = shutil.copytree(stored_scene, tmp_path / "scene")
    path = scene / "scene_camera_sl.json"
    flat = damaged(lambda view: view.update(cam_K=[0, 0, 9, 0, 9, 9, 0, 0, 1]))
    path.write_text(flat(path.read_text()))
    with pytest.raises(DatasetError, match=r"depth_sl/000000\.png: .*fx_px is 0.0"):
        read_views([scene], options=FileOptions(), own=OWN)


def test_frames_must_have_the_size_of_the_view(depth_file, tmp_path):
    (view,) = read_views([depth_file], options=FILE_OPTIONS, own=OWN)
    for name, size in (("white", (30, 40)), ("black", (15, 20))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full(size, 32768, dtype=np.uint16))
    frames = read_frames(tmp_path / "white.png", tmp_path / "white.png", view)
    assert frames.white == pytest.approx(np.full((30, 40), 32768 / 65535))
    with pytest.raises(GraycastError, match="is 20 x 15 pixels, the depth 40 x 30"):
        read_frames(tmp_path / "white.png", tmp_path / "black.png", view)


def test_white_and_black_frames_separate_lamps_and_projector_for_any_reflectance():
    """Oracle: the formula of the two frames, in which the reflectance cancels."""
    rng = np.random.default_rng(3)
    w, a, r = rng.uniform(1, 2, (30, 40)), rng.uniform(0.2, 0.9, (30, 40)), rng.uniform(0.1, 0.8)
    for scale in (0.3, 2.0):
        white, black = r * (w + scale * a) / 5, r * (w / 250 + scale * a) / 5
        frames = Frames(white=white, black=black)
        estimate = light_scale(w, a, 1 / 250, frames, np.ones((30, 40), dtype=bool), 1)
        assert estimate == pytest.approx(scale, rel=1e-9)
    with pytest.raises(GraycastError, match="too little"):
        light_scale(w, 0 * a, 1 / 250, frames, np.ones((30, 40), dtype=bool), 1)
