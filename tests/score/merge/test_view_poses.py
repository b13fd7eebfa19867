"""Views with known errors of their poses, over surfaces in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from seen import from_above, plane_depth, sphere_depth, view

from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.rig.optics import Optics
from graycast.score.merge import fuse
from graycast.score.merge.view import points_of
from graycast.score.merge.view_poses import pose_doubts

CAMERA = Optics(width_px=200, height_px=150, fx_px=250.0, fy_px=250.0, cx_px=99.5, cy_px=74.5)
SIGMA_M = 0.2e-3
UP = np.array([0.0, 0.0, 1.0])
PLACES = [from_above(-0.15), from_above(0.2, 0.05), from_above(0.0, -0.2)]


def taken(T, name, rng):
    """Return a view of three balls on a floor, which constrain its pose in every direction."""
    depth_m = plane_depth(T, UP, 0.0, CAMERA)
    for middle in ((0.05, 0.05, 0.05), (0.12, -0.08, 0.08), (-0.05, -0.1, 0.06)):
        depth_m = np.fmin(depth_m, sphere_depth(T, middle, middle[2], CAMERA))
    noisy = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
    return view(noisy, T, SIGMA_M, name=name, camera=CAMERA)


@pytest.fixture(scope="module")
def views():
    rng = np.random.default_rng(1)
    return [taken(T, f"v{i}", rng) for i, T in enumerate(PLACES)]


def doubts(views, **changed):
    poses = {v.name: v.T_world_cam for v in views} | changed
    posed = [replace(v, T_world_cam=poses[v.name]) for v in views]
    return pose_doubts(posed, [points_of(v) for v in posed])


@pytest.mark.slow
def test_correct_view_poses_cause_no_warning(views):
    assert fuse(views).doubts == ()
    assert doubts(views[:2]) == ()
    assert doubts(views[:1]) == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "shift_mm"), [(1, (0, 0, 1)), (2, (0, 0, -1)), (0, (5, 0, 0)), (2, (0, -5, 0))]
)
def test_a_shifted_view_is_named_with_its_correction(views, number, shift_mm):
    """Oracle: the correction is the inverse of the applied shift, in the camera's axes."""
    T = views[number].T_world_cam @ rigid(np.eye(3), np.array(shift_mm) / 1e3)
    (doubt,) = doubts(views, **{f"v{number}": T})
    assert doubt.startswith(f"view v{number} does not lie where view v")
    back = [float(x) for x in doubt.split("axes ")[1].split(")")[0].split(", ")]
    np.testing.assert_allclose(back, -np.array(shift_mm), atol=0.4)  # limit of agreement
    assert "its pose is off" in doubt


@pytest.mark.slow
def test_a_slightly_rotated_view_is_named_with_the_angle(views):
    turn = Rotation.from_rotvec(np.radians([0.3, 0.0, 0.0])).as_matrix()
    (doubt,) = doubts(views, v2=views[2].T_world_cam @ rigid(turn, np.zeros(3)))
    assert doubt.startswith("view v2")
    assert float(doubt.split("turn by ")[1].split()[0]) == pytest.approx(0.3, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (inverse, "inverted"),
        (lambda T: rigid(T[:3, :3], -T[:3, 3]), "given the opposite translation"),
        (lambda T: T @ rigid(axis_rotation("z", -np.pi / 2), np.zeros(3)), "turned by 90 degrees"),
    ],
)
def test_common_mistakes_in_a_pose_are_named(views, change, message):
    (doubt,) = doubts(views, v1=change(views[1].T_world_cam))
    assert doubt.startswith("view v1 ") and f"with the pose of view v1 {message}" in doubt


def test_a_pose_that_cannot_be_corrected_is_reported(views):
    far = views[1].T_world_cam @ rigid(np.eye(3), np.array([0.0, 0.0, 0.3]))
    (doubt,) = doubts(views, v1=far)
    assert "view v1 agrees with no other view" in doubt and "does not help" in doubt


@pytest.mark.slow
def test_a_mistake_common_to_all_poses_is_named(views):
    (doubt,) = doubts(views, **{v.name: inverse(v.T_world_cam) for v in views})
    assert "with all poses inverted they do" in doubt


def test_with_only_two_views_the_wrong_one_cannot_be_identified(views):
    T = views[1].T_world_cam @ rigid(np.eye(3), np.array([0.0, 0.0, 1e-3]))
    (doubt,) = doubts(views[:2], v1=T)
    assert "one of the two poses is off" in doubt
