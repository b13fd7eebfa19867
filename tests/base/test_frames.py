"""Rigid transforms obey the laws of their group, and random rotations are uniform."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.base.frames import (
    axis_rotation,
    inverse,
    is_rigid,
    look_at,
    pixel_grid,
    random_quaternions,
    rigid,
    rotation_from_quaternion,
    transform_points,
)

SAMPLES = 20_000


def random_rigid(n, seed):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(n, rng=rng).as_matrix()
    return np.stack([rigid(R, t) for R, t in zip(rotation, rng.normal(size=(n, 3)), strict=True)])


def test_the_inverse_of_each_transform_in_an_array_undoes_the_transform():
    T = random_rigid(20, seed=0)
    assert np.abs(inverse(T) @ T - np.eye(4)).max() < 1e-14
    assert np.abs(inverse(T) - np.linalg.inv(T)).max() < 1e-14


def test_a_product_of_transforms_applies_them_one_after_the_other():
    """`T_a_b @ T_b_c` moves points as the two transforms do one after the other."""
    T_a_b, T_b_c = random_rigid(2, seed=1)
    point_c = np.random.default_rng(2).normal(size=(7, 3))
    in_steps = transform_points(T_a_b, transform_points(T_b_c, point_c))
    assert np.allclose(transform_points(T_a_b @ T_b_c, point_c), in_steps, rtol=0, atol=1e-13)


def test_a_transform_rotates_a_point_before_it_translates_it():
    quarter_turn = rigid(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([10.0, 0, 0]))
    assert np.array_equal(transform_points(quarter_turn, np.array([[1.0, 2, 3]])), [[8, 1, 3]])


@pytest.mark.parametrize("axis", "xyz")
def test_rotations_about_an_axis_agree_with_scipy(axis):
    assert np.allclose(axis_rotation(axis, 0.7), Rotation.from_euler(axis, 0.7).as_matrix())


def test_quaternions_of_any_length_give_the_rotations_of_scipy():
    q = np.random.default_rng(3).normal(size=(5, 2, 4))
    expected = Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(5, 2, 3, 3)
    assert np.allclose(rotation_from_quaternion(q), expected, rtol=0, atol=1e-14)


def worst_moment_in_standard_errors(R):
    """Return the largest deviation of sample moments from those of the uniform (Haar) measure.

    Every entry is a coordinate of a uniform unit vector: mean 0, variance 1/3, mean square 1/3,
    variance of the square 1/5 - 1/9. The angle's density is (1 - cos a) / pi on [0, pi]:
    mean pi/2 + 2/pi, mean square pi^2/3 + 4.
    """
    n = len(R)
    first = np.abs(R.mean(axis=0)) / math.sqrt(1 / 3 / n)
    second = np.abs((R**2).mean(axis=0) - 1 / 3) / math.sqrt((1 / 5 - 1 / 9) / n)
    angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    mean = math.pi / 2 + 2 / math.pi
    deviation = math.sqrt(math.pi**2 / 3 + 2 * 2 - mean**2)
    third = abs(angle.mean() - mean) / (deviation / math.sqrt(n))
    return max(first.max(), second.max(), third)


def test_random_rotations_are_uniform():
    """With 19 statistics, chance exceeds 5 standard errors for one seed in 90,000."""
    R = rotation_from_quaternion(random_quaternions(SAMPLES, np.random.default_rng(4)))
    assert worst_moment_in_standard_errors(R) < 5


@pytest.mark.parametrize("pitch", [math.pi, math.pi / 2])
def test_the_uniformity_check_rejects_uniform_euler_angles(pitch):
    half = np.array([math.pi, pitch, math.pi])
    angles = np.random.default_rng(5).uniform(-half, half, size=(SAMPLES, 3))
    assert worst_moment_in_standard_errors(Rotation.from_euler("zyx", angles).as_matrix()) > 20


def test_the_uniformity_check_rejects_quaternions_from_a_cube():
    q = np.random.default_rng(6).uniform(-1, 1, size=(SAMPLES, 4))
    assert worst_moment_in_standard_errors(rotation_from_quaternion(q)) > 5


def test_a_reflection_or_a_scaling_is_not_a_rigid_transform():
    assert is_rigid(random_rigid(1, seed=7)[0])
    assert not is_rigid(np.diag([1.0, 1, -1, 1]))
    assert not is_rigid(np.diag([1.001, 1, 1, 1]))
    assert not is_rigid(np.diag([1.0, 1, 1, 2]))
    assert not is_rigid(np.full((4, 4), np.nan))


def test_the_pose_of_a_camera_aims_at_its_target_with_the_y_axis_down():
    eye, target = np.array([0.3, -0.4, 1.2]), np.array([0.1, 0.2, 0.0])
    T_world_cam = look_at(eye, target, np.array([0.0, 0.0, -1.0]))
    assert is_rigid(T_world_cam)
    distance = np.linalg.norm(target - eye)
    in_cam = transform_points(inverse(T_world_cam), target[None])[0]
    assert np.allclose(in_cam, [0, 0, distance], atol=1e-14)
    assert T_world_cam[2, 1] < 0  # the image's y axis points down in the world
    assert abs(T_world_cam[2, 0]) < 1e-15  # The image's x axis is horizontal.


def test_a_camera_whose_view_is_parallel_to_its_down_direction_is_refused():
    with pytest.raises(ValueError, match="y axis along"):
        look_at(np.zeros(3), np.array([0.0, 0, -1]), np.array([0.0, 0, -1]))


def test_the_top_left_pixel_centre_is_the_origin_and_x_runs_along_a_row():
    grid = pixel_grid(3, 5)
    assert grid[0, 0].tolist() == [0, 0]
    assert grid[2, 4].tolist() == [4, 2]
    assert grid[1, 3].tolist() == [3, 1]
