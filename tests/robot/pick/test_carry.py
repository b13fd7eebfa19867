"""What is remembered of failed grips between two attempts."""

import numpy as np

from graycast.robot.pick.carry import FREED_M, World
from graycast.world.scene import Layout

EMPTY = World(
    layout=Layout(T_world_part=np.zeros((0, 4, 4)), part_index=np.zeros(0, int)),
    numbers=np.zeros(0, int),
    hand_eye=np.eye(4),
    q=np.zeros(6),
)
HERE = np.zeros(3)
NEAR, FAR = np.array([0.9 * FREED_M, 0.0, 0.0]), np.array([0.0, 1.1 * FREED_M, 0.0])


def test_a_failed_place_is_remembered_until_something_near_it_is_taken():
    failed = EMPTY.gripped(NEAR, taken=False).gripped(FAR, taken=False)
    assert failed.tabu == (NEAR, FAR)
    assert failed.gripped(HERE, taken=True).tabu == (FAR,)
    again = failed.gripped(HERE, taken=True).gripped(HERE, taken=True)
    assert again.tabu == (FAR,)
    assert again.gripped(HERE, taken=False).tabu == (FAR, HERE)


def test_a_place_without_a_way_likewise_and_a_failure_elsewhere_leaves_it():
    blocked = EMPTY.without_way((NEAR,)).without_way((FAR,))
    assert blocked.blocked == (NEAR, FAR) and blocked.tabu == ()
    assert blocked.gripped(HERE, taken=True).blocked == (FAR,)
    assert blocked.gripped(HERE, taken=False).blocked == (NEAR, FAR)
