"""Test the pose recall of BOP and the command `graycast robot score-poses`."""

import csv
import json

import numpy as np
import pytest
from stage import BOX_CORNERS, box_part, centred, lambert

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, rigid, transform_points
from graycast.cli import main
from graycast.dataset.read.pose_results import PoseEstimate, pose_results_text
from graycast.dataset.training import open_examples
from graycast.dataset.write.models import read_models
from graycast.rig.meshdepth import rasterize
from graycast.score.evaluate import Protocol, evaluate_poses
from graycast.score.evaluate.pose_recall import PictureTruth, count_picture, matched, solid_of
from graycast.world.parts import Mesh, Symmetry

# An array type of pycocotools 2.0.11 is older than NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def test_the_estimate_with_the_highest_score_is_matched_first():
    """It takes the instance that it fits best, even if only this one fits the second estimate."""
    error = np.array([[0.1, 0.3], [0.2, 0.9]])
    assert matched(error, 0.5) == [(0, 0)]
    assert matched(error, 1.0) == [(0, 0), (1, 1)]
    assert matched(error[::-1], 0.5) == [(0, 0), (1, 1)]
    assert matched(error, 0.1) == []  # The error must be below the threshold, not equal to it.


@pytest.fixture(scope="module")
def scene(master):
    example = open_examples(master)[0]
    models = read_models(master)
    solids = {k: solid_of(m.mesh, m.symmetry, m.diameter_m) for k, m in models.items()}
    truth = PictureTruth(
        scene_id=example.scene_id,
        camera=example.camera,
        measured_m=example.scanner_depth_m.astype(np.float64),
        obj_id=example.obj_id,
        T_cam_part=example.T_cam_part,
        to_find=~example.hidden(0.1),
    )
    return truth, solids


def estimates(truth, shift_m=(0.0, 0.0, 0.0)):
    return [
        PoseEstimate(
            scene_id=truth.scene_id, im_id=0, obj_id=int(obj_id), score=1.0,
            T_cam_part=rigid(T[:3, :3], T[:3, 3] + np.array(shift_m)),
        )
        for obj_id, T, there in zip(truth.obj_id, truth.T_cam_part, truth.to_find, strict=True)
        if there
    ]  # fmt: skip


def test_true_poses_count_as_correct_by_every_criterion(scene):
    for one in count_picture(scene[0], estimates(scene[0]), scene[1]):
        assert one.to_find > 0
        for hit in (one.vsd, one.mssd, one.mspd, one.near):
            np.testing.assert_array_equal(hit, one.to_find)
        np.testing.assert_allclose(one.angle_rad, 0, atol=1e-7)


def test_a_shifted_pose_is_correct_only_for_thresholds_above_the_shift(scene):
    """MSSD is the shift; thresholds are 5 % of the diameter apart, and one at the shift fails."""
    truth, solids = scene
    shift = 0.22 * min(solid.diameter_m for solid in solids.values())
    for one in count_picture(truth, estimates(truth, (0, 0, shift)), solids):
        share = shift / solids[one.obj_id].diameter_m
        expected = one.to_find * (np.arange(1, 11) * 0.05 > share)
        np.testing.assert_array_equal(one.mssd, expected)
        assert one.near == 0
        np.testing.assert_allclose(one.shift_m, shift, rtol=1e-6)


def test_the_number_of_counted_estimates_is_limited_to_the_number_of_instances(scene):
    """Wrong estimates with higher scores displace the right ones."""
    truth, solids = scene
    wrong = [
        PoseEstimate(scene_id=e.scene_id, im_id=0, obj_id=e.obj_id, score=2.0,
                     T_cam_part=rigid(np.eye(3), np.array([9.0, 9.0, 9.0])))
        for e in estimates(truth)
    ]  # fmt: skip
    for one in count_picture(truth, estimates(truth) + wrong, solids):
        assert one.mssd.sum() == 0 and one.vsd.sum() == 0


def cube(side_m, middle_m, camera, T):
    """Return a picture of a cube with perfect depth, and its solid; its origin is off-centre."""
    mesh = Mesh(
        vertices_m=BOX_CORNERS * side_m / 2 + middle_m,
        faces=box_part(1.0, lambert(0.5)).mesh.faces,
    )
    solid = solid_of(mesh, Symmetry(), np.sqrt(3) * side_m)
    raster = rasterize(transform_points(T, mesh.vertices_m), mesh.faces, camera)
    truth = PictureTruth(
        scene_id=0, camera=camera, measured_m=raster.over(camera)[1].copy(), obj_id=np.array([1]),
        T_cam_part=T[None], to_find=np.array([True]),
    )  # fmt: skip
    return truth, {1: solid}


def counted(truth, solids, T):
    estimate = PoseEstimate(scene_id=0, im_id=0, obj_id=1, score=1.0, T_cam_part=T)
    return count_picture(truth, [estimate], solids)[0]


def test_the_distance_is_measured_to_the_middle_of_the_part():
    """A rotation by 4 degrees about the centre moves the origin, 100 mm away, by 7 mm."""
    middle = np.array([0.1, 0.0, 0.0])
    T = rigid(np.eye(3), np.array([-0.1, 0.0, 1.0]))
    truth, solids = cube(0.04, middle, centred(80, 60, 200), T)
    R = axis_rotation("y", np.radians(4))
    about_middle = counted(truth, solids, T @ rigid(R, middle - R @ middle))
    assert about_middle.near == 1 and about_middle.shift_m[0] < 1e-9
    about_origin = counted(truth, solids, T @ rigid(R, np.zeros(3)))
    assert about_origin.near == 0
    np.testing.assert_allclose(about_origin.shift_m, 0.2 * np.sin(np.radians(2)))


def test_vsd_compares_distances_and_not_depths():
    """At 45 degrees to the axis, a shift along the ray by 5.8 % of the diameter is a shift of 4.1 %
    in z. Only the former exceeds the first tolerance of 5 %."""
    T = rigid(np.eye(3), np.array([1.0, 0.0, 1.0]))
    truth, solids = cube(0.2, np.zeros(3), centred(480, 200, 200), T)
    along = 0.058 * solids[1].diameter_m * np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    one = counted(truth, solids, rigid(np.eye(3), T[:3, 3] + along))
    assert not one.vsd[0].any() and one.vsd[1, -1] == 1


# --- the command ----------------------------------------------------------------------------------


def whole(dataset, shift_m=(0.0, 0.0, 0.0)):
    shifted = []
    for example in open_examples(dataset):
        shifted += [
            PoseEstimate(
                scene_id=example.scene_id, im_id=0, obj_id=int(obj_id), score=0.9, time_s=0.5,
                T_cam_part=rigid(T[:3, :3], T[:3, 3] + np.array(shift_m)),
            )
            for obj_id, T, there in zip(
                example.obj_id, example.T_cam_part, ~example.hidden(0.1), strict=True
            ) if there
        ]  # fmt: skip
    return shifted


@pytest.mark.slow
def test_the_command_writes_figures_for_all_parts_and_for_each_part(master, tmp_path, capsys):
    results, out = tmp_path / "poses.csv", tmp_path / "scores"
    results.write_text(pose_results_text(whole(master)))
    assert main(["robot", "score-poses", str(results), "--on", str(master), "--out", str(out)]) == 0
    content = json.loads((out / "poses.json").read_text())
    names = [row["name"] for row in content["rows"]]
    assert names[0] == "all" and len(names) == 3
    for row in content["rows"]:
        for name in ("AR", "AR_VSD", "AR_MSSD", "AR_MSPD", "within_5deg_3mm"):
            assert row[name]["value"] == row[name]["low"] == row[name]["high"] == 1.0
    assert content["median_s"] == 0.5
    rows = list(csv.DictReader((out / "poses.csv").read_text().splitlines()))
    assert {row["figure"] for row in rows} >= {"AR", "rotation_deg", "translation_mm"}
    assert "| all |" in capsys.readouterr().out


def test_recall_is_a_share_of_all_instances_to_find(master, tmp_path):
    """If half of the poses are removed at random, AR is the share that remains."""
    shifted = whole(master)
    half = [
        shifted[k] for k in np.random.default_rng(0).permutation(len(shifted))[: len(shifted) // 2]
    ]
    results = tmp_path / "poses.csv"
    results.write_text(pose_results_text(sorted(half, key=lambda e: e.scene_id)))
    rows = evaluate_poses(results, master, protocol=Protocol(draws=50)).rows
    assert rows[0].to_find == len(shifted)
    assert rows[0].figures["AR"].value == pytest.approx(len(half) / len(shifted))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: {"scene_id": 77}, "has scene 77, image 0, which the dataset's set does not"),
        (lambda e: {"im_id": 3}, "image 3, which the dataset's set does not have"),
        (lambda e: {"obj_id": 9}, "has object 9, the dataset has 1, 2"),
    ],
)
def test_results_of_another_dataset_are_refused(master, tmp_path, change, message):
    one = whole(master)[0]
    keys = {"scene_id": one.scene_id, "im_id": 0, "obj_id": one.obj_id} | change(one)
    results = tmp_path / "poses.csv"
    other = PoseEstimate(**keys, score=1.0, T_cam_part=one.T_cam_part.copy())
    results.write_text(pose_results_text([other]))
    with pytest.raises(GraycastError, match=message):
        evaluate_poses(results, master, protocol=Protocol(draws=50))


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "in metres"), (1 / 25.4, "another unit")])
def test_poses_in_a_wrong_unit_are_refused_and_the_unit_is_named(master, tmp_path, factor, unit):
    scaled = [
        PoseEstimate(
            scene_id=one.scene_id, im_id=0, obj_id=one.obj_id, score=0.9,
            T_cam_part=rigid(one.T_cam_part[:3, :3], factor * one.T_cam_part[:3, 3]),
        )
        for one in whole(master)
    ]  # fmt: skip
    results = tmp_path / "poses.csv"
    results.write_text(pose_results_text(scaled))
    with pytest.raises(GraycastError, match=f"{unit}.*write it in millimetres"):
        evaluate_poses(results, master, protocol=Protocol(draws=50))


def test_detections_are_refused_with_the_command_that_scores_them(master, tmp_path, capsys):
    arguments = ["robot", "score-poses", str(tmp_path), "--on", str(master), "--out", str(tmp_path)]
    assert main(arguments) == 1
    assert "score detections with graycast detector score" in capsys.readouterr().err
