"""Scenes in BOP's form: several images, pictures of several formats, errors for damaged files."""

import json

import cv2
import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.dataset.files.records import Images
from graycast.dataset.files.safe_reading import Unreadable
from graycast.dataset.files.scene_folder import AnyPose, AnyView, SceneFolder
from graycast.real.realism import read_scans

K = [50.0, 0, 19.5, 0, 50.0, 14.5, 0, 0, 1]
POSE = {"obj_id": 7, "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 900.0]}


@pytest.fixture
def scene(tmp_path):
    """Write images 10 and 9, in this order, in forms that BOP allows but we do not write."""
    folder = tmp_path / "000048"
    for kind, number, ending in (("depth", 9, "png"), ("rgb", 9, "jpg"), ("rgb", 10, "tif")):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        image = np.full((30, 40), number, np.uint16 if kind == "depth" else np.uint8)
        cv2.imwrite(str(folder / kind / f"{number:06d}.{ending}"), image)
    view = {"cam_K": K, "depth_scale": 0.1, "elev": 3}
    (folder / "scene_camera.json").write_text(json.dumps({"10": view, "9": view}))
    (folder / "scene_gt.json").write_text(json.dumps({"10": [], "9": [POSE, POSE | {"obj_id": 2}]}))
    return SceneFolder(folder)


def test_images_are_located_by_their_numbers(scene):
    assert sorted(scene.record("scene_camera", Images[AnyView])) == [9, 10]
    assert scene.of_image("scene_camera", 10, AnyView).cam_K == K
    assert [pose.obj_id for pose in scene.of_instances("scene_gt", 9, AnyPose)] == [7, 2]
    assert scene.of_instances("scene_gt", 10, AnyPose) == []


def test_a_picture_may_have_any_format_and_may_be_missing(scene):
    assert scene.picture("rgb", 10).max() == 10
    assert abs(int(scene.picture("rgb", 9).mean()) - 9) <= 1  # JPEG
    assert scene.picture("depth", 10) is None
    assert scene.png("depth", 9).dtype == np.uint16


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda s: s.of_image("scene_gt_info", 9, AnyView), r"scene_gt_info\.json is missing"),
        (lambda s: s.of_image("scene_camera", 8, AnyView), "json says nothing of image 8"),
        (lambda s: s.of_instances("scene_camera", 9, AnyPose), "image 9 must have a list"),
        (lambda s: s.of_instances("scene_gt", 9, AnyView), "image 9, instance 0: cam_K: Field"),
        (lambda s: s.png("depth", 10), r"depth/000010\.png is missing"),
        (lambda s: s.mask("mask_visib", 3, 9), r"mask_visib/000009_000003\.png is missing"),
    ],
)
def test_missing_files_are_named(scene, read, message):
    with pytest.raises(Unreadable, match=message):
        read(scene)


def test_a_truncated_picture_is_reported(scene):
    path = scene.png_path("depth", 9)
    path.write_bytes(path.read_bytes()[:-12])  # the last chunk
    with pytest.raises(Unreadable, match="cut off or damaged"):
        scene.picture("depth", 9)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"first": {"cam_K": K, "depth_scale": 0.1}}, "first"),
        ({"9": {"cam_K": K[:8], "depth_scale": 0.1}}, r"9\.cam_K"),
        ({"9": {"cam_K": K}}, r"9\.depth_scale"),
        ({"9": None}, "9: Input should be an object"),
    ],
)
def test_a_scene_without_its_cameras_gives_a_clear_error_in_realism(scene, content, message):
    path = scene.path / "scene_camera.json"
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=f"^{path}: {message}.*needs cam_K"):
        list(read_scans([scene.path]))
