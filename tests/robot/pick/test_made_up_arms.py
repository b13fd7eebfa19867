"""Paths of simple arms in closed form, without the libraries for robots."""

import numpy as np
import pytest

from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.robot.grasp import CARRIED_M_S2
from graycast.robot.pick.arm.motion import Trajectory, straight
from graycast.robot.pick.arm.robot import Robot, _turned
from graycast.robot.pick.arm.ways import Load, Surroundings, _gently
from graycast.robot.pick.tool.tools import SuctionTool, T_flange_tip


class Polar(Robot):
    """An arm that rotates about a vertical axis, stretches and lifts; its hand does not rotate."""

    def __init__(self):
        pass

    def flange(self, q):
        return at(q[1] * np.cos(q[0]), q[1] * np.sin(q[0]), q[2])

    def follow(self, T_base_flange, near):
        x, y, z = T_base_flange[:3, 3]
        turn = np.arctan2(y, x)
        return np.array(
            [turn + 2 * np.pi * np.round((near[0] - turn) / (2 * np.pi)), np.hypot(x, y), z]
        )

    def touches(self, q, obstacles):
        return None


def at(x, y, z):
    return rigid(np.eye(3), np.array([x, y, z]))


@pytest.mark.parametrize(("aside_m", "smooth"), [(0.0335, True), (0.0310, False), (0.0, False)])
def test_a_path_on_which_a_joint_would_jump_is_refused(aside_m, smooth):
    """In a step of 10 mm near its axis, the arm turns by atan(10 mm / distance)."""
    arm = Polar()
    start = arm.follow(at(-0.1, aside_m, 0.2), np.zeros(3))
    corners = straight(arm, start, at(0.1, aside_m, 0.2), ())
    assert (corners is not None) == smooth
    if smooth:
        places = np.stack([arm.flange(q)[:3, 3] for q in corners])
        np.testing.assert_allclose(places[:, 1:], [[aside_m, 0.2]] * 21)
        np.testing.assert_allclose(places[:, 0], np.linspace(-0.1, 0.1, 21), atol=1e-12)


class Wrist(Robot):
    """An arm that rotates its tool about the tip, which does not move."""

    def __init__(self):
        pass

    def flange(self, q):
        turned = rigid(axis_rotation("y", q[0]), np.zeros(3))
        return turned @ inverse(T_flange_tip(SuctionTool()))


@pytest.mark.parametrize("below_m", [0.01, 0.1])
def test_the_acceleration_limit_applies_to_the_end_of_a_long_part(below_m):
    """At 20 rad/s, the end moves in a circle: its acceleration is 400 / s^2 times the radius."""
    here = Surroundings(
        T_base_world=np.eye(4), T_flange_tip=T_flange_tip(SuctionTool()), standing=(),
        q_place=np.zeros(1), approach_m=0.06, straight_m_s=0.25, lift_off_m_s=0.05,
    )  # fmt: skip
    time_s = 1e-3 * np.arange(200)
    way = Trajectory(time_s=time_s, q=20 * time_s[:, None])
    slow = _gently(Wrist(), here, way, Load(below_m=below_m, aside_m=0.02))
    stretched = max(np.sqrt(400 * below_m / CARRIED_M_S2), 1.0)
    assert slow.seconds == pytest.approx(stretched * way.seconds, rel=1e-3)
    np.testing.assert_array_equal(slow.q, way.q)


def test_joint_angles_are_moved_into_the_limits_by_whole_turns():
    """Law for joints of all ranges: the result is within the limits if any equivalent angle is."""
    rng = np.random.default_rng(0)
    low, high = -rng.uniform(0.5, 6.0, 2000), rng.uniform(0.5, 6.0, 2000)
    near, q = rng.uniform(low, high), rng.uniform(-9, 9, 2000)
    angles = _turned(q, near, low, high)
    turns = (angles - q) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    alike = q + 2 * np.pi * np.arange(-3, 4)[:, None]
    possible = ((alike >= low) & (alike <= high)).any(axis=0)
    np.testing.assert_array_equal((angles >= low) & (angles <= high), possible)
    assert 0.1 < possible.mean() < 0.95
