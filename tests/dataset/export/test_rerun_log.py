"""Recordings are read by rerun's own reader, and compared with the simulation."""

import json
import shutil

import cv2
import numpy as np
import pytest
from simulated_dataset import SCALE_MM

from graycast.base.frames import inverse, pixel_grid
from graycast.dataset.export import Options, export
from graycast.rig.optics import rays

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = [
    pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def recording(master, tmp_path_factory):
    return recorded(master, tmp_path_factory.mktemp("rerun") / "out")


def recorded(dataset, out, workers=1):
    """Export; return the columns of each entity by name, and the static ones, as lists of rows."""
    pytest.importorskip("rerun", reason="needs rerun: run make extras")
    from rerun.chunk import RrdReader

    export(dataset, out, Options(format="rerun"), workers=workers)
    rows, static = {}, {}
    for chunk in RrdReader(out / "train.rrd").stream():
        columns = rows if not chunk.is_static else static
        own = columns.setdefault(chunk.entity_path, {})
        batch = chunk.to_record_batch()
        own["types"] = [f"{field.name} {field.type}" for field in batch.schema]
        for name, column in batch.to_pydict().items():
            if name != "rerun.controls.RowId":  # These ids are random.
                own.setdefault(name, []).extend(column)
    return rows, static


def values(recording, entity, name):
    """Return the values of a component by the number of the picture."""
    columns = recording[0][f"/world/scanner{entity}"]
    assert set(columns) >= {"picture", name}
    return dict(zip(columns["picture"], columns[name], strict=True))


def picture(blob):
    return cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_UNCHANGED)


def columns_of(matrices):
    """Return 3x3 matrices, which rerun stores by columns."""
    return np.reshape(matrices, (-1, 3, 3)).transpose(0, 2, 1)


def test_pictures_and_depth_in_a_recording_are_those_of_the_dataset(recording, samples):
    rgb = values(recording, "/camera/image", "EncodedImage:blob")
    assert list(rgb) == list(samples)
    label = values(recording, "/camera/truth/instances", "SegmentationImage:buffer")
    for scene_id, sample in samples.items():
        assert np.array_equal(picture(rgb[scene_id])[..., ::-1], sample.rgb)
        for entity, depth_m in (
            ("/camera/depth", sample.scanner_depth.depth_m),
            ("/camera/truth/depth", sample.truth.depth_m),
        ):
            steps = picture(values(recording, entity, "EncodedDepthImage:blob")[scene_id])
            (steps_per_m,) = values(recording, entity, "EncodedDepthImage:meter")[scene_id]
            error_m = np.abs(steps / steps_per_m - np.nan_to_num(depth_m))
            assert error_m.max() < 0.51e-3 * SCALE_MM + 1e-7
        numbers = np.array(label[scene_id][0], dtype=np.uint8).view("<u2")
        assert np.array_equal(numbers.reshape(sample.gray.shape), sample.truth.instance + 1)


def test_points_and_frames_of_a_recording_are_those_of_the_scanner(recording, samples):
    """The camera looks along z of the optical frame: x right, y down, z forward."""
    point = values(recording, "/points", "Points3D:positions")
    color = values(recording, "/points", "Points3D:colors")
    for scene_id, sample in samples.items():
        depth_m, camera = sample.scanner_depth.depth_m, sample.scene.rig.camera
        known = np.isfinite(depth_m)
        ray = rays(camera, pixel_grid(camera.height_px, camera.width_px))
        np.testing.assert_allclose(point[scene_id], (ray * depth_m[..., None])[known], atol=2e-5)
        rgba = np.array(color[scene_id], dtype=">u4").view(np.uint8).reshape(-1, 4)
        assert np.array_equal(rgba[:, :3], sample.rgb[known])
        T = sample.scene.T_world_cam
        (at,) = values(recording, "", "Transform3D:translation")[scene_id]
        (turn,) = columns_of(values(recording, "", "Transform3D:mat3x3")[scene_id])
        np.testing.assert_allclose(at, T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(turn, T[:3, :3], atol=1e-6)
        (K,) = columns_of(values(recording, "/camera", "Pinhole:image_from_camera")[scene_id])
        np.testing.assert_allclose(K, camera.K, rtol=1e-6)
        (axes,) = values(recording, "/camera", "Pinhole:camera_xyz")[scene_id]
        assert axes == [3, 2, 5]  # right, down and forward


def test_parts_of_a_recording_have_their_meshes_and_true_poses(recording, samples):
    for scene_id, sample in samples.items():
        T_cam_part = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part
        for index, part in enumerate(sample.scene.parts):
            entity = f"/truth/parts/{index + 1}"
            T = T_cam_part[np.array(sample.layout.part_index) == index]
            at = values(recording, entity, "InstancePoses3D:translations")[scene_id]
            turn = columns_of(values(recording, entity, "InstancePoses3D:mat3x3")[scene_id])
            np.testing.assert_allclose(at, T[:, :3, 3], atol=1e-6)
            np.testing.assert_allclose(turn, T[:, :3, :3], atol=1e-6)
            mesh = recording[1][f"/world/scanner{entity}"]
            vertex_m = np.array(mesh["Mesh3D:vertex_positions"][0])
            corners = {tuple(corner) for corner in np.round(part.mesh.vertices_m, 6)}
            assert {tuple(corner) for corner in np.round(vertex_m.astype(float), 6)} == corners


def test_a_part_that_is_absent_from_a_picture_is_not_at_the_origin(master, tmp_path):
    """Rerun 0.41 draws a mesh whose list of poses is empty once, at the origin of its frame."""
    dataset = shutil.copytree(master, tmp_path / "dataset")
    path = dataset / "train" / "000003" / "scene_gt.json"
    gt = json.loads(path.read_text())
    path.write_text(json.dumps({"0": [pose | {"obj_id": 1} for pose in gt["0"]]}))
    recording = recorded(dataset, tmp_path / "out")
    size = values(recording, "/truth/parts/2", "InstancePoses3D:mat3x3")
    assert np.array_equal(size[3], np.zeros((1, 9)))
    assert len(values(recording, "/truth/parts/1", "InstancePoses3D:mat3x3")[3]) == 8


def test_the_number_of_processes_does_not_change_the_values_of_a_recording(
    recording, master, tmp_path
):
    assert recorded(master, tmp_path / "out", workers=2) == recording
