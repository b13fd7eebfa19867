"""Straight ways of an arm in closed form, which needs no library of robots."""

import numpy as np
import pytest

from graycast.base.frames import rigid
from graycast.robot.pick.motion import straight
from graycast.robot.pick.robot import Robot


class Polar(Robot):
    """It turns about an upright axis, stretches and lifts; its hand never turns."""

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
def test_a_way_on_which_a_joint_would_jump_is_none(aside_m, smooth):
    """Beside its axis, within a step of 10 mm, the arm turns by atan(10 mm / aside): 0.3 rad at
    32.3 mm."""
    arm = Polar()
    start = arm.follow(at(-0.1, aside_m, 0.2), np.zeros(3))
    corners = straight(arm, start, at(0.1, aside_m, 0.2), ())
    assert (corners is not None) == smooth
    if smooth:
        places = np.stack([arm.flange(q)[:3, 3] for q in corners])
        np.testing.assert_allclose(places[:, 1:], [[aside_m, 0.2]] * 21)
        np.testing.assert_allclose(places[:, 0], np.linspace(-0.1, 0.1, 21), atol=1e-12)
