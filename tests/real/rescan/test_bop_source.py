"""Reading of datasets in BOP's form: a cube of known pose, and files with errors."""

import json
import pickle

import cv2
import numpy as np
import pytest
import simulated_dataset

from graycast.base.errors import DatasetError
from graycast.base.frames import axis_rotation, rigid
from graycast.dataset.training.foreign import open_foreign
from graycast.real.rescan.bop_source import open_bop
from graycast.real.rescan.open_source import open_source
from graycast.real.rescan.source import SourceOptions
from graycast.rig.optics import points

from .scene_files import (
    CAMERA,
    POSE,
    SCALE_MM,
    SIDE_MM,
    corners,
    gt_of,
    png,
    true_depth_m,
    write_dataset,
    write_json,
    write_models,
    write_scene,
)


def opened(path, **options):
    return open_bop(path, SourceOptions(**options))


def change(path, **entry):
    """Change keys of image 0, or of its first instance; None removes a key."""
    content = json.loads(path.read_text())
    first = content["0"][0] if isinstance(content["0"], list) else content["0"]
    for key, value in entry.items():
        first[key] = value
        if value is None:
            del first[key]
    path.write_text(json.dumps(content))


def refusal(path, *words, **options):
    """Check that opening and reading give an error of one line with these words; return it."""
    with pytest.raises(DatasetError) as caught:
        source = opened(path, **options)
        for scene_id, image_id in source.images:
            source.read(scene_id, image_id)
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text
    return text


def test_a_cube_is_read_with_its_depth_pose_and_camera(tmp_path):
    """Oracle: the depth of `rig/meshdepth` at the pose in the file."""
    rgb = np.full((48, 64, 3), (200, 90, 40), np.uint8)
    split = write_dataset(tmp_path, images=(0, 7), rgb=rgb)
    source = pickle.loads(pickle.dumps(opened(split)))
    assert (source.split, source.sensor, len(source.scenes)) == ("train_pbr", "", 1)
    assert source.images == ((0, 0), (0, 7))
    image = source.read(0, 7)
    assert np.abs(image.depth_m - true_depth_m()).max() <= SCALE_MM / 2e3 * 1.001
    assert np.abs(image.rgb.astype(int) - rgb).max() <= 2  # a JPEG
    assert image.camera == CAMERA
    assert image.step_m == pytest.approx(SCALE_MM / 1e3)
    assert image.obj_id.tolist() == [1]
    assert np.allclose(image.T_cam_part, POSE, rtol=0, atol=1e-9)
    assert np.allclose(source.parts[1].mesh.extent_m, SIDE_MM / 1e3)
    assert source.parts[1].name == "obj_000001"
    assert source.plain == {1}


def test_parts_of_a_dataset_of_graycast_keep_their_names(tmp_path):
    simulated_dataset.write_dataset(tmp_path / "ours", (0,))
    claim = json.loads((tmp_path / "ours/graycast.json").read_text())
    names = {part["obj_id"]: part["name"] for part in claim["parts"]}
    parts = opened(tmp_path / "ours/train").parts
    assert {obj_id: part.name for obj_id, part in parts.items()} == names
    assert not any(name.startswith("obj_") for name in names.values())


def test_the_reader_for_training_reads_the_same_depth_and_poses(tmp_path):
    """Oracle: the reader for training, which shares no code for depth and poses."""
    split = write_dataset(tmp_path, rgb=np.zeros((48, 64, 3), np.uint8))
    scene = split / "000000"
    infos = [{"px_count_visib": 9, "visib_fract": 1.0}]
    write_json(scene / "scene_gt_info.json", {"0": infos})
    png(scene / "mask_visib/000000_000000.png", np.full((48, 64), 255, np.uint8))
    example, image = open_foreign(split).read(0), opened(split).read(0, 0)
    assert np.allclose(example.depth_m, image.depth_m, rtol=0, atol=1e-7)
    assert np.allclose(example.T_cam_part, image.T_cam_part, rtol=0, atol=1e-12)
    assert np.array_equal(example.rgb, image.rgb)


def test_files_from_blenderproc_are_read_with_either_models_or_depth(tmp_path):
    split = write_dataset(tmp_path / "lm")
    (tmp_path / "lm/models").rename(tmp_path / "elsewhere")
    write_json(tmp_path / "lm/camera.json", {"fx": 1.0})
    refusal(split, "--models", "--depth-only")
    assert list(opened(split, models=tmp_path / "elsewhere").parts) == [1]
    source = opened(split, depth_only=True)
    image = source.read(0, 0)
    assert source.parts == {} and image.obj_id.shape == (0,)
    assert image.T_cam_part.shape == (0, 4, 4)


def test_cad_models_are_preferred_to_reconstructed_models_and_models_for_scores(tmp_path):
    split = write_dataset(tmp_path)
    (tmp_path / "models").rename(tmp_path / "models_eval")
    assert np.allclose(opened(split).parts[1].mesh.extent_m, 0.06)
    write_models(tmp_path / "models_reconst", side=70.0)
    assert np.allclose(opened(split).parts[1].mesh.extent_m, 0.07)
    write_models(tmp_path / "models_cad", side=80.0)
    assert np.allclose(opened(split).parts[1].mesh.extent_m, 0.08)


def test_grey_pictures_have_three_equal_bands(tmp_path):
    split = write_dataset(tmp_path)
    level = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 21
    assert cv2.imwrite(str(split / "000000/x.tif"), level)
    (split / "000000/gray").mkdir()
    (split / "000000/x.tif").rename(split / "000000/gray/000000.tif")
    rgb = opened(split).read(0, 0).rgb
    assert (rgb == (level // 256)[..., None]).all()
    png(split / "000000/rgb/000000.png", np.full((48, 64, 3), (1, 2, 3), np.uint8))
    assert (opened(split).read(0, 0).rgb == (3, 2, 1)).all()  # Colours are preferred.


def test_depth_in_tiff_floats_is_scaled_and_may_have_unknown_pixels(tmp_path):
    split = write_dataset(tmp_path)
    (split / "000000/depth/000000.png").unlink()
    values = (true_depth_m() * 1e3 / SCALE_MM).astype(np.float32)
    values[2, 3] = np.nan
    file = split / "000000/depth/000000.tif"
    assert cv2.imwrite(str(file), values)
    image = opened(split).read(0, 0)
    assert np.isnan(image.depth_m[2, 3]) and image.step_m == 0
    assert np.nanmax(np.abs(image.depth_m - true_depth_m())) < 1e-6
    assert cv2.imwrite(str(file), -values)
    refusal(split, "000000.tif", "negative depth")


def test_distortion_is_read_if_a_file_states_it(tmp_path):
    split = write_dataset(tmp_path)
    change(split / "000000/scene_camera.json", distortion=[0.1, 0, 0, 0.001, 0])
    assert opened(split).read(0, 0).camera.distortion == (0.1, 0.0, 0.0, 0.001, 0.0)


def test_a_sensor_is_selected_by_name(tmp_path):
    scene = tmp_path / "val/000003"
    write_scene(scene, "photoneo")
    write_scene(scene, "cam1")
    write_scene(scene, "sl")  # The files of our scanner are not those of another sensor.
    (scene / "aolp_cam1").mkdir()
    write_models(tmp_path / "models")
    change(scene / "scene_gt_cam1.json", cam_t_m2c=[0.0, 0.0, 700.0])
    text = refusal(tmp_path / "val", "--sensor NAME", "cam1, photoneo")
    assert "sl" not in text.partition("one of")[2]
    refusal(tmp_path / "val", "no sensor xyz", "cam1, photoneo", sensor="xyz")
    source = opened(tmp_path / "val", sensor="cam1")
    assert source.sensor == "cam1" and source.images == ((3, 0),)
    assert source.read(3, 0).T_cam_part[0, 2, 3] == pytest.approx(0.7)
    for path in scene.glob("*photoneo*"):
        path.rename(tmp_path / path.name)
    assert opened(tmp_path / "val").sensor == "cam1"
    (scene / "depth_cam1").rename(tmp_path / "depth_cam1")
    refusal(tmp_path / "val", "depth_cam1", "--sensor")


def test_a_dataset_with_one_camera_needs_no_sensor(tmp_path):
    refusal(write_dataset(tmp_path), "leave out --sensor cam1", sensor="cam1")


def test_a_depth_scale_given_by_the_user_replaces_the_scale_in_the_file(tmp_path):
    split = write_dataset(tmp_path)
    doubled = opened(split, depth_scale_mm=2 * SCALE_MM).read(0, 0).depth_m
    assert np.allclose(doubled, 2 * opened(split).read(0, 0).depth_m)
    change(split / "000000/scene_camera.json", depth_scale=None)
    refusal(split, "scene_camera.json", "image 0", "--depth-scale")
    assert np.isfinite(opened(split, depth_scale_mm=1.0).read(0, 0).depth_m).all()
    with pytest.raises(DatasetError, match="--depth-scale is -1"):
        SourceOptions(depth_scale_mm=-1.0)


def test_an_image_has_no_objects_only_if_the_file_says_so(tmp_path):
    split = write_dataset(tmp_path, images=(0, 1))
    write_json(split / "000000/scene_gt.json", {"0": [gt_of(POSE)], "1": []})
    assert opened(split).read(0, 1).obj_id.tolist() == []
    write_json(split / "000000/scene_gt.json", {"0": [gt_of(POSE)]})
    refusal(split, "scene_gt.json", "image 1", "empty list", "--depth-only")
    write_json(split / "000000/scene_gt.json", {"0": [], "1": [], "5": []})
    refusal(split, "scene_camera.json", "image 5")


def test_objects_behind_the_camera_and_outside_the_image_are_kept(tmp_path):
    split = write_dataset(tmp_path)
    behind = rigid(np.eye(3), np.array([0.0, 0.0, -0.4]))
    write_json(split / "000000/scene_gt.json", {"0": [gt_of(POSE), gt_of(behind)]})
    assert opened(split).read(0, 0).T_cam_part[1, 2, 3] == -0.4
    info = [{"px_count_visib": n, "visib_fract": 0.0} for n in (5, 0)]
    write_json(split / "000000/scene_gt_info.json", {"0": info})
    assert len(opened(split).read(0, 0).obj_id) == 2
    info[1]["px_count_visib"] = 1
    write_json(split / "000000/scene_gt_info.json", {"0": info})
    refusal(split, "scene_gt.json", "image 0, instance 1", "behind the camera", "-400 mm")
    write_json(split / "000000/scene_gt_info.json", {"0": info[:1]})
    refusal(split, "scene_gt_info.json", "1 instances", "2")


def test_rounded_rotations_are_corrected_and_invalid_rotations_are_refused(tmp_path):
    split = write_dataset(tmp_path)
    rounded = np.round(POSE[:3, :3], 3).ravel().tolist()
    change(split / "000000/scene_gt.json", cam_R_m2c=rounded)
    R = opened(split).read(0, 0).T_cam_part[0, :3, :3]
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12
    assert np.abs(R - POSE[:3, :3]).max() < 1e-3
    mirror = (POSE[:3, :3] @ np.diag([1.0, 1.0, -1.0])).ravel().tolist()
    for wrong in (mirror, (1.02 * POSE[:3, :3]).ravel().tolist(), [0.0] * 9):
        change(split / "000000/scene_gt.json", cam_R_m2c=wrong)
        refusal(split, "scene_gt.json", "image 0, instance 0", "rotation")


@pytest.mark.parametrize(
    ("name", "entry", "words"),
    [
        ("scene_camera", {"cam_K": None}, ("image 0", "cam_K")),
        (
            "scene_camera",
            {"cam_K": [-90, 0, 31, 0, 90, 24, 0, 0, 1]},
            ("cam_K", "fx greater than 0"),
        ),
        ("scene_camera", {"cam_K": [90, 0, 31, 0, 0, 24, 0, 0, 1]}, ("cam_K", "fy_px")),
        ("scene_camera", {"cam_K": [90, 3, 31, 0, 90, 24, 0, 0, 1]}, ("cam_K", "fx, 0, cx")),
        ("scene_camera", {"cam_K": [float("nan")] * 9}, ("cam_K", "finite")),
        ("scene_camera", {"depth_scale": 0}, ("depth_scale", "greater than 0")),
        ("scene_gt", {"obj_id": 4}, ("no model obj_000004.ply", "object 4", "--depth-only")),
        ("scene_gt", {"obj_id": "1"}, ("obj_id", "integer")),
        ("scene_gt", {"cam_t_m2c": [0, 0, -500]}, ("instance 0", "behind", "OpenCV")),
        ("scene_gt", {"cam_t_m2c": [0, 0, 0.5]}, ("0.5 mm", "m2mm=True")),
        ("scene_gt", {"cam_t_m2c": [0, float("nan"), 500]}, ("cam_t_m2c", "finite")),
    ],
)
def test_impossible_values_in_a_file_are_refused_by_name(tmp_path, name, entry, words):
    split = write_dataset(tmp_path)
    change(split / f"000000/{name}.json", **entry)
    refusal(split, f"{name}.json" if entry != {"obj_id": 4} else "models", *words)


def test_damaged_and_missing_files_are_named(tmp_path):
    split = write_dataset(tmp_path, rgb=np.zeros((48, 64, 3), np.uint8))
    scene = split / "000000"
    depth, gt = scene / "depth/000000.png", scene / "scene_gt.json"
    content, text = depth.read_bytes(), gt.read_text()
    depth.write_bytes(content[:-60])
    refusal(split, str(depth), "cut off or damaged")
    depth.unlink()
    refusal(split, str(depth), "no such file")
    png(depth, np.full((48, 64), 90, np.uint8))
    refusal(split, str(depth), "uint8", "16 bits")
    png(depth, np.full((24, 32), 9000, np.uint16))
    refusal(split, "rgb/000000.jpg", "64 x 48", "32 x 24")
    png(depth, np.full((48, 64), 9000, np.uint16))
    jpeg = (scene / "rgb/000000.jpg").read_bytes()
    (scene / "rgb/000000.jpg").write_bytes(jpeg[: len(jpeg) // 2])
    refusal(split, "rgb/000000.jpg", "damaged")
    (scene / "rgb/000000.jpg").write_bytes(jpeg)
    gt.write_text(text[:-30])
    refusal(split, str(gt), "JSON")
    gt.write_text(text.replace("]}]}", ']}], "00": []}'))
    refusal(split, str(gt), "image 0", "twice")
    gt.unlink()
    refusal(split, str(gt), "missing")
    assert opened(split, depth_only=True).read(0, 0).depth_m.shape == (48, 64)


def test_folders_that_are_not_a_split_are_refused(tmp_path):
    split = write_dataset(tmp_path)
    refusal(tmp_path / "models", "no scenes", "lm/train_pbr")
    write_json(split / "000000/scene_camera.json", {})
    write_json(split / "000000/scene_gt.json", {})
    refusal(split, "no images")
    write_scene(split / "0")
    refusal(split, "same number")


@pytest.mark.parametrize("none", [0, 65535])
def test_a_depth_of_zero_or_of_the_largest_number_is_unknown(tmp_path, none):
    """Symptom: 65535 became a wall at 6.55 m."""
    split = write_dataset(tmp_path)
    steps = np.full((48, 64), 5000, np.uint16)
    steps[:, 0] = none
    png(split / "000000/depth/000000.png", steps)
    depth_m = opened(split).read(0, 0).depth_m
    assert np.isnan(depth_m[:, 0]).all() and np.allclose(depth_m[:, 1:], 0.5)


@pytest.mark.parametrize("name", ["0000.png", "0.png", "0000000.tif", "000000.npy", "0000.npy"])
def test_pictures_whose_names_have_another_number_of_digits_are_read(tmp_path, name):
    split = write_dataset(tmp_path)
    folder = split / "000000/depth"
    stored = folder / "000000.png"
    steps = cv2.imread(str(stored), cv2.IMREAD_UNCHANGED)
    expected = opened(split).read(0, 0).depth_m
    stored.unlink()
    (folder / "0001.png").write_bytes(b"of another image")
    (folder / "._0000.png").write_bytes(b"of macOS")
    np.save(folder / name, steps) if name.endswith("npy") else png(folder / name, steps)
    image = opened(split).read(0, 0)
    np.testing.assert_array_equal(image.depth_m, expected)
    assert image.step_m == SCALE_MM / 1e3
    if name[:6] != "000000":  # BOP's own name is preferred to other names.
        png(folder / "00.png", steps)
        refusal(split, "are both image 0")


def test_lengths_of_rays_are_converted_to_z(tmp_path):
    """Oracle: the distance of each point from the camera, which BlenderProc calls `distance`."""
    split = write_dataset(tmp_path)
    z_m = opened(split).read(0, 0).depth_m
    length_m = np.linalg.norm(points(CAMERA, z_m), axis=-1)
    png(split / "000000/depth/000000.png", np.rint(length_m * 1e3 / SCALE_MM).astype(np.uint16))
    source = open_source(split, SourceOptions(ray_length=True))
    assert np.abs(source.read(0, 0).depth_m - z_m).max() <= 0.51e-3 * SCALE_MM
    assert source.scenes == {}  # The result has its own depth, which is z.
    assert source.notes == ()
    (note,) = open_source(split).notes
    assert "seems to be the length of each ray" in note and "give --ray-length" in note


def test_the_cube_of_these_tests_is_at_its_stated_pose():
    """The test data are consistent: at the projected centre of the cube, depth is the cube's."""
    x, y, z = POSE[:3, 3]
    column = round(CAMERA.fx_px * x / z + CAMERA.cx_px)
    row = round(CAMERA.fy_px * y / z + CAMERA.cy_px)
    nearest = np.linalg.norm(corners(SIDE_MM / 1e3)[0])
    assert z - nearest < true_depth_m()[row, column] < z
    assert np.allclose(axis_rotation("x", 0.4) @ axis_rotation("z", 0.7), POSE[:3, :3])
