"""Paths are collision-free, take the least time, respect all limits, and depend on the seed."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="needs pinocchio: pip install 'graycast[pick]'")
pytest.importorskip("ompl", reason="needs ompl: pip install 'graycast[pick]'")
pytest.importorskip("toppra", reason="needs toppra: pip install 'graycast[pick]'")

import coal

from graycast.base.frames import rigid
from graycast.robot.pick.arm.motion import RISE_S, drive, plan, straight
from graycast.robot.pick.arm.robot import ACCELERATION_RAD_S2, Obstacle, open_robot


@pytest.fixture(scope="module")
def ur(tmp_path_factory):
    return open_robot("ur5e", folder=tmp_path_factory.mktemp("none"))


def wall(x, y, z, size):
    return Obstacle(
        name="wall", shape=coal.Box(*size), T_base_shape=rigid(np.eye(3), np.array([x, y, z]))
    )


def least_s(angle, speed):
    """Return a joint's least time from rest to rest, with or without a phase of full speed."""
    if angle < speed**2 / ACCELERATION_RAD_S2:
        return 2 * np.sqrt(angle / ACCELERATION_RAD_S2)
    return angle / speed + speed / ACCELERATION_RAD_S2


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.5])
def test_a_single_joint_takes_the_least_time_of_a_bang_bang_law(ur, angle):
    end = ur.home.copy()
    end[0] += angle
    driven = drive(ur, np.stack([ur.home, end]))
    assert driven.seconds == pytest.approx(least_s(angle, np.pi) + RISE_S, rel=0.01, abs=0.011)
    np.testing.assert_allclose(driven.q[-1], end, atol=1e-6)


def test_no_joint_exceeds_its_speed(ur):
    rng = np.random.default_rng(3)
    corners = ur.home + rng.uniform(-1.0, 1.0, (4, 6))
    driven = drive(ur, corners, step_s=0.004)
    speed = np.diff(driven.q, axis=0) / np.diff(driven.time_s)[:, None]
    assert (np.abs(speed) <= ur.speed * 1.01).all()
    gain = np.diff(speed, axis=0) / 0.004
    assert np.abs(gain).max() <= 1.1 * ACCELERATION_RAD_S2
    # A change of the acceleration over its whole range takes at least the rise time.
    jerk = np.diff(gain, axis=0) / 0.004
    assert np.abs(jerk).max() <= 1.1 * 2 * ACCELERATION_RAD_S2 / RISE_S


@pytest.mark.slow
def test_the_path_leads_around_a_wall(ur):
    """A wall blocks the direct path from one side of the robot to the other."""
    start, goal = ur.home.copy(), ur.home.copy()
    start[0], goal[0] = -1.0, 1.0
    between = [wall(-0.49, -0.13, 0.4, (0.3, 0.02, 0.5))]
    corners = plan(ur, start, goal, between, seed=0)
    assert len(corners) > 2
    for a, b in pairwise(corners):
        for share in np.linspace(0, 1, 100):
            assert ur.touches(a + share * (b - a), between) is None
    assert len(plan(ur, start, goal, [], seed=0)) == 2
    again = plan(ur, start, goal, between, seed=0)
    assert (corners == again).all()


def test_the_planner_returns_none_if_no_path_exists(ur):
    goal = ur.home.copy()
    goal[0] = 1.0
    T = ur.flange(goal)
    in_it = [wall(*T[:3, 3], (0.1, 0.1, 0.1))]
    assert plan(ur, ur.home, goal, in_it, seed=0) is None


def test_a_straight_path_keeps_the_tool_s_line_and_ends_at_a_wall(ur):
    here = ur.flange(ur.home)
    down = here.copy()
    down[2, 3] -= 0.12
    corners = straight(ur, ur.home, down, [])
    for q in corners:
        T = ur.flange(q)
        np.testing.assert_allclose(T[:2, 3], here[:2, 3], atol=1e-4)
        np.testing.assert_allclose(T[:3, :3], here[:3, :3], atol=1e-3)
    np.testing.assert_allclose(ur.flange(corners[-1])[:3, 3], down[:3, 3], atol=1e-4)
    floor = [wall(here[0, 3], here[1, 3], here[2, 3] - 0.1, (0.2, 0.2, 0.02))]
    assert straight(ur, ur.home, down, floor) is None
