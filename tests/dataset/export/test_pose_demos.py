"""Folders of the pose demos are read as FoundationPose and SAM-6D read them."""

import json

import cv2
import numpy as np
import pictured
import pytest
import trimesh
from PIL import Image
from simulated_dataset import visible

from graycast.base.errors import GraycastError
from graycast.base.frames import inverse
from graycast.dataset.export import Options, export

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def read(folder):
    """Return picture, depth [m], mask, K and pose of FoundationPose's reader `YcbineoatReader`."""
    (file,) = sorted((folder / "rgb").glob("*.png"))
    rgb = np.array(Image.open(file))[..., :3]
    depth_m = cv2.imread(str(folder / "depth" / file.name), -1) / 1e3
    mask = cv2.imread(str(folder / "masks" / file.name), -1).astype(bool)
    K = np.loadtxt(folder / "cam_K.txt").reshape(3, 3)
    (pose,) = (folder / "annotated_poses").glob("*")
    return rgb, depth_m, mask, K, np.loadtxt(pose).reshape(4, 4)


@pytest.fixture(scope="module")
def folders(master, tmp_path_factory):
    out = tmp_path_factory.mktemp("demos") / "out"
    export(master, out, Options(format="foundationpose"))
    return out


def test_a_demo_folder_has_picture_depth_mask_and_pose_of_the_most_visible_instance(
    folders, samples
):
    names = set()
    for scene_id, sample in samples.items():
        instances, masks, _ = visible(sample)
        share = {
            i: mask.sum() / sample.truth.amodal[i].mask.sum()
            for i, mask in zip(instances, masks, strict=True)
        }
        for index in {sample.layout.part_index[i] for i in instances}:
            same = [i for i in instances if sample.layout.part_index[i] == index]
            best = max(same, key=lambda i: (share[i], (sample.truth.instance == i).sum()))
            name = f"{scene_id:06d}_{index + 1:06d}"
            names.add(name)
            rgb, depth_m, mask, K, T_cam_part = read(folders / "train" / name)
            assert np.array_equal(rgb, sample.rgb)
            true_m = np.nan_to_num(sample.scanner_depth.depth_m)
            assert np.abs(depth_m - true_m).max() < 0.52e-3
            assert np.array_equal(depth_m > 0, true_m > 0)
            assert np.array_equal(mask, sample.truth.instance == best)
            assert np.array_equal(K, sample.scene.rig.camera.K)
            expected = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part[best]
            np.testing.assert_allclose(T_cam_part, expected, atol=1e-9)
            camera = json.loads((folders / "train" / name / "camera.json").read_text())
            assert camera == {"cam_K": K.ravel().tolist(), "depth_scale": 1.0}
    assert {path.name for path in (folders / "train").iterdir()} == names


def test_the_mesh_in_metres_covers_the_mask_and_the_model_in_millimetres_has_its_shape(
    folders, samples
):
    """Law: the mesh, moved by the pose and projected with K, contains the visible mask."""
    for folder in sorted((folders / "train").iterdir()):
        obj = f"obj_{folder.name[-6:]}"
        mesh = trimesh.load(folders / "models_m" / obj / "mesh.obj")
        model = trimesh.load(folders / "models" / f"{obj}.ply")
        np.testing.assert_allclose(1e3 * mesh.bounds, model.bounds, atol=1e-4)
        _, depth_m, mask, K, T = read(folder)
        corner = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        assert corner[:, 2].min() > 0
        pixel = corner @ K.T
        hull = cv2.convexHull((pixel[:, :2] / pixel[:, 2:]).astype(np.float32))
        row, column = mask.nonzero()
        inside = [
            cv2.pointPolygonTest(hull, (float(x), float(y)), True)
            for x, y in zip(column, row, strict=True)
        ]
        assert min(inside) > -0.1
        measured_m = depth_m[mask & (depth_m > 0)]
        assert measured_m.min() > corner[:, 2].min() - 2e-3
        assert measured_m.max() < corner[:, 2].max() + 2e-3


def test_the_textured_mesh_of_a_demo_folder_keeps_its_texture(folders, samples):
    mesh = trimesh.load(folders / "models_m" / "obj_000001" / "mesh.obj")
    texture = samples[0].scene.parts[0].material.texture
    assert np.array_equal(np.array(mesh.visual.material.image)[..., :3], texture)


@pytest.mark.slow
def test_pictures_of_a_demo_folder_have_no_lens_distortion(tmp_path):
    """Oracle: OpenCV's projection tells which pixel of the lens sees the ray of each new pixel."""
    samples = pictured.write_dataset(tmp_path / "out", (0,), pictured.lensed_rig())
    options = Options(format="foundationpose", depth="perfect")
    export(tmp_path / "out", tmp_path / "demos", options)
    rgb, depth_m, _, K, _ = read(tmp_path / "demos" / "train" / "000000_000001")
    y, x = np.mgrid[0:120, 0:160].astype(float)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ np.linalg.inv(K).T
    lens = np.array(samples[0].scene.rig.camera.distortion)
    at = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), K, lens)[0].reshape(120, 160, 2)
    assert np.abs(at - np.stack([x, y], axis=-1)).max() > 2
    column, row = np.moveaxis(np.rint(at).astype(int), -1, 0)
    sure = (np.abs(at - np.rint(at)) < 0.45).all(axis=-1)
    sure &= (column >= 0) & (column < 160) & (row >= 0) & (row < 120)
    assert sure.mean() > 0.5
    true_m = samples[0].truth.depth_m[row[sure], column[sure]]
    assert np.abs(depth_m[sure] - true_m).max() < 0.52e-3
    # A colour is a mean of the pixels around its place, so it is between their extremes.
    kernel, source = np.ones((3, 3), np.uint8), samples[0].rgb
    assert (rgb[sure] <= cv2.dilate(source, kernel)[row[sure], column[sure]]).all()
    assert (rgb[sure] >= cv2.erode(source, kernel)[row[sure], column[sure]]).all()


def test_a_demo_folder_needs_depth(master, tmp_path):
    with pytest.raises(GraycastError, match="depth is 'none': choose one of perfect, scanner"):
        Options(format="foundationpose", depth="none")
