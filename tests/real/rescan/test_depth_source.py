"""Reading of folders with only depth, and recognition of a folder's layout."""

import json
import pickle

import numpy as np
import pytest

from graycast.base.errors import ConfigError, DatasetError
from graycast.real.rescan.open_source import open_source
from graycast.real.rescan.source import SourceOptions
from graycast.rig.optics import points
from graycast.world.parts.material_presets import material_preset

from .scene_files import CAMERA, png, true_depth_m, write_dataset, write_json

K = CAMERA.K.tolist()


def opened(path, **options):
    return open_source(path, SourceOptions(**options))


def refusal(path, *words, **options):
    with pytest.raises(DatasetError) as caught:
        source = opened(path, **options)
        for scene_id, image_id in source.images:
            source.read(scene_id, image_id)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


@pytest.fixture
def intrinsics(tmp_path):
    write_json(tmp_path / "K.json", {"K": K})
    return str(tmp_path / "K.json")


@pytest.mark.parametrize(
    "content",
    [
        {"K": K},
        {"cam_K": np.ravel(K).tolist()},
        {"fx": 90.0, "fy": 91.0, "cx": 31.0, "cy": 24.5, "width": 64},
        "90,91,31,24.5",
    ],
)
def test_depth_in_floats_is_in_metres_and_uses_the_camera_of_the_user(tmp_path, content):
    folder = tmp_path / "scans"
    (folder / "depth").mkdir(parents=True)
    np.save(folder / "depth/b.npy", true_depth_m())
    far = true_depth_m() + 0.5
    far[3, 4] = np.nan
    np.save(folder / "depth/a.npy", far)
    text = content
    if not isinstance(content, str):
        text = str(tmp_path / "camera.json")
        (tmp_path / "camera.json").write_text(json.dumps(content))
    source = pickle.loads(pickle.dumps(opened(folder / "depth", intrinsics=text)))
    assert (source.split, source.scenes, source.parts) == ("depth", {}, {})
    assert source.images == ((0, 0), (0, 1))
    assert source.read(0, 0).camera == CAMERA
    assert np.array_equal(source.read(0, 0).depth_m, far, equal_nan=True)
    image = source.read(0, 1)
    assert image.step_m == 0
    assert np.array_equal(image.depth_m, true_depth_m())
    assert image.rgb is None and len(image.obj_id) == len(image.T_cam_part) == 0


def test_depth_in_whole_numbers_uses_the_scale_of_the_user(tmp_path, intrinsics):
    steps = np.rint(true_depth_m() * 1e4).astype(np.uint16)
    rgb = np.random.default_rng(0).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    png(tmp_path / "depth/x.png", steps)
    png(tmp_path / "rgb/x.png", rgb[..., ::-1])
    refusal(tmp_path, "x.png", "--depth-scale", intrinsics=intrinsics)
    image = opened(tmp_path, intrinsics=intrinsics, depth_scale_mm=0.1).read(0, 0)
    assert np.abs(image.depth_m - true_depth_m()).max() <= 0.51e-4
    assert image.step_m == pytest.approx(1e-4)
    assert np.array_equal(image.rgb, rgb)
    png(tmp_path / "rgb/x.png", rgb[:20])
    refusal(tmp_path, "64 x 48", "64 x 20", intrinsics=intrinsics, depth_scale_mm=0.1)
    png(tmp_path / "depth/x.png", (steps >> 8).astype(np.uint8))
    refusal(tmp_path, "x.png", "16 bits", intrinsics=intrinsics, depth_scale_mm=0.1)


def test_options_that_need_models_are_refused_for_depth_alone(tmp_path, intrinsics):
    (tmp_path / "depth").mkdir()
    refusal(tmp_path, "--intrinsics")
    refusal(tmp_path, "depth", intrinsics=intrinsics)
    np.save(tmp_path / "depth/a.npy", true_depth_m() * 1000)
    refusal(tmp_path, "a.npy", "millimetres", intrinsics=intrinsics)
    np.save(tmp_path / "depth/a.npy", -true_depth_m())
    refusal(tmp_path, "a.npy", "z axis", intrinsics=intrinsics)
    refusal(tmp_path, "leave out --sensor", intrinsics=intrinsics, sensor="a")
    write_json(tmp_path / "K.json", {"fx": -90.0, "fy": 91.0, "cx": 31.0, "cy": 24.5})
    refusal(tmp_path, "K.json", "camera matrix", intrinsics=intrinsics)
    (tmp_path / "depth/a.npy").rename(tmp_path / "depth/a.exr")
    write_json(tmp_path / "K.json", {"K": K})
    refusal(tmp_path, "EXR", "NPY", intrinsics=intrinsics)


def test_lengths_of_rays_are_converted_to_z(tmp_path, intrinsics):
    (tmp_path / "depth").mkdir()
    length_m = np.linalg.norm(points(CAMERA, true_depth_m()), axis=-1)
    np.save(tmp_path / "depth/a.npy", length_m)
    source = opened(tmp_path, intrinsics=intrinsics, ray_length=True)
    np.testing.assert_allclose(source.read(0, 0).depth_m, true_depth_m(), rtol=1e-12)
    assert source.notes == ()
    assert "give --ray-length" in opened(tmp_path, intrinsics=intrinsics).notes[0]
    refusal(tmp_path, "layout depth alone", "leave out --unit", intrinsics=intrinsics, unit="m")


def test_depth_alone_has_a_background_and_no_objects(tmp_path, intrinsics):
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth/a.npy", true_depth_m())
    looks = tmp_path / "looks.yaml"
    assert opened(tmp_path, intrinsics=intrinsics).background is None
    looks.write_text("background: rubber")
    source = opened(tmp_path, intrinsics=intrinsics, materials=looks)
    assert source.background == material_preset("rubber").material
    for name in ("nut", "default"):
        looks.write_text(f"background: {{base_color: [0.1, 0.1, 0.1]}}\n{name}: brass")
        with pytest.raises(ConfigError, match=f"the id or name {name}: choose background$"):
            opened(tmp_path, intrinsics=intrinsics, materials=looks)
    for words, message in (("texture: a.png", "cannot have texture"), ("rough: 1", "background")):
        looks.write_text(f"background: {{{words}}}")
        with pytest.raises(ConfigError, match=message):
            opened(tmp_path, intrinsics=intrinsics, materials=looks)


def test_the_layout_of_a_folder_is_recognised(tmp_path):
    split = write_dataset(tmp_path / "lm")
    assert opened(split).scenes
    refusal(split, "layout BOP", "leave out --intrinsics", intrinsics="1,1,1,1")
    refusal(tmp_path / "lm", "whole dataset", "train_pbr")
    refusal(split / "000000", "one scene", str(split))
    refusal(tmp_path / "lm/models", "no scenes", "lm/train_pbr")
    refusal(tmp_path / "nowhere", "no such folder")
    refusal(tmp_path / "lm/models/obj_000001.ply", "no folder")
    with pytest.raises(DatasetError, match="no image 5 of scene 0"):
        opened(split).read(0, 5)
    link = tmp_path / "lm/linked"
    (tmp_path / "big").mkdir()
    split.rename(tmp_path / "big/train_pbr")
    link.symlink_to(tmp_path / "big/train_pbr")
    assert list(opened(link).parts) == [1]
