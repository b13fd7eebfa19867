"""Paths of a pick: their ends, the transport of a part, and the reason if there is no path."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="needs pinocchio: pip install 'graycast[pick]'")

import coal

from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.robot.grasp import CARRIED_M_S2
from graycast.robot.pick.arm.robot import Obstacle, open_robot
from graycast.robot.pick.arm.ways import Load, Surroundings, Ways, WaySearch
from graycast.robot.pick.outcome import Outcome
from graycast.robot.pick.tool.suction_tool import SuctionTool
from graycast.robot.pick.tool.tools import T_flange_tip

TOOL = SuctionTool(length_m=0.2)
LOAD = Load(below_m=0.1, aside_m=0.05)
NOWHERE = Obstacle(
    name="the heap", shape=coal.Sphere(0.01), T_base_shape=rigid(np.eye(3), np.array([0, 0, -3.0]))
)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return open_robot("ur5e", folder=tmp_path_factory.mktemp("none")).mount(TOOL.pieces())


@pytest.fixture(scope="module")
def here(arm):
    """Return surroundings in which the robot's base is at the world's origin."""
    flat = Surroundings(
        T_base_world=np.eye(4),
        T_flange_tip=T_flange_tip(TOOL),
        standing=(),
        q_place=arm.home,
        approach_m=0.06,
        straight_m_s=0.25,
        lift_off_m_s=0.05,
    )
    place = rigid(np.eye(3), np.array([-0.1, -0.5, 0.25]))
    loaded = arm.mount((LOAD.piece(flat.T_flange_tip),))
    reached = arm.reach(flat.flange(place), arm.home, seed=0)
    q = next(q for q in reached if loaded.touches(q, ()) is None)
    return Surroundings(
        T_base_world=np.eye(4), T_flange_tip=flat.T_flange_tip, standing=(), q_place=q,
        approach_m=0.06, straight_m_s=0.25, lift_off_m_s=0.05,
    )  # fmt: skip


# The tool leans by 20 degrees, above a point in front of the robot.
GRIP = rigid(axis_rotation("y", np.radians(20)), np.array([-0.5, 0.1, 0.05]))


def ways_of(arm, here, *, heap=NOWHERE, grip=GRIP, **changes):
    settings = {"up_m": 0.25, "load": LOAD, "seed": 0} | changes
    round_tool = settings.pop("round_tool", True)
    obstacles = (*here.standing, heap)
    search = WaySearch(robot=arm, here=here, obstacles=obstacles, **settings)
    return search.ways(arm.home, grip, round_tool=round_tool)


def tip(arm, here, q):
    return arm.flange(q) @ here.T_flange_tip


def test_the_paths_are_continuous_and_end_at_their_poses(arm, here):
    way = ways_of(arm, here)
    for before, after in pairwise(way.all):
        np.testing.assert_allclose(before.q[-1], after.q[0], atol=1e-6)
    np.testing.assert_allclose(way.to.q[0], arm.home, atol=1e-9)
    np.testing.assert_allclose(way.away.q[-1], here.q_place, atol=1e-6)
    at = tip(arm, here, way.down.q[-1])
    np.testing.assert_allclose(at[:3, 3], GRIP[:3, 3], atol=1e-4)
    np.testing.assert_allclose(at[:3, 2], GRIP[:3, 2], atol=1e-3)  # rotated only about its axis
    before = tip(arm, here, way.down.q[0])
    np.testing.assert_allclose(before[:3, 3], GRIP[:3, 3] + 0.06 * GRIP[:3, 2], atol=1e-4)
    raised = tip(arm, here, way.up.q[-1])
    np.testing.assert_allclose(raised[:3, 3], GRIP[:3, 3] + [0, 0, 0.25], atol=1e-4)
    np.testing.assert_allclose(raised[:3, 2], [0, 0, 1], atol=1e-3)  # upright


@pytest.mark.slow
def test_a_tilted_tool_that_cannot_be_raised_becomes_upright_on_its_way_up(arm, here):
    """No rotation of the leaning tool has joint angles at the top; the upright tool has some."""
    grip = rigid(axis_rotation("y", np.radians(-45)), np.array([-0.5, 0.1, 0.1]))
    raised = rigid(np.eye(3), grip[:3, 3] + [0, 0, 0.3])
    for turn in range(8):
        leaning = raised @ inverse(rigid(np.eye(3), grip[:3, 3])) @ grip
        turned = leaning @ rigid(axis_rotation("z", turn * np.pi / 4), np.zeros(3))
        assert not arm.reach(here.flange(turned), arm.home, seed=0)
    way = ways_of(arm, here, grip=grip, up_m=0.3)
    assert isinstance(way, Ways)
    poses = np.stack([tip(arm, here, way.up.at(t)) for t in np.linspace(0, way.up.seconds, 40)])
    off = np.linalg.norm(poses[:, :2, 3] - grip[:2, 3], axis=1)
    assert off.max() < 0.01 and (np.diff(poses[:, 2, 3]) > -1e-4).all()  # The path is straight.
    assert (np.diff(poses[:, 2, 2]) > -1e-4).all()  # The tilt decreases.
    np.testing.assert_allclose(poses[-1][:3, 2], [0, 0, 1], atol=1e-3)


@pytest.mark.slow
def test_a_part_is_carried_with_no_more_force_than_its_grip_was_tested_for(arm, here):
    """The engine's steps (2 ms) are averaged over 20 ms; a longer average would hide spikes."""
    way = ways_of(arm, here)
    for carried in way.loaded:
        time_s = np.arange(0, carried.seconds, 0.002)
        for below in (0.0, LOAD.below_m):
            place = np.stack(
                [
                    T[:3, 3] - below * T[:3, 2]
                    for T in (tip(arm, here, carried.at(t)) for t in time_s)
                ]
            )
            smooth = np.stack([np.convolve(axis, np.ones(10) / 10, "valid") for axis in place.T], 1)
            second = np.diff(smooth[::10], n=2, axis=0) / 0.02**2
            assert np.linalg.norm(second, axis=1).max() < 1.1 * CARRIED_M_S2


def test_straight_paths_do_not_exceed_the_stated_speed(arm, here):
    way = ways_of(arm, here)
    assert way.down.seconds >= 0.06 / 0.25
    assert way.off.seconds >= 0.01 / 0.05
    assert way.up.seconds >= 0.25 / 0.25


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grip", "outcome", "words"),
    [
        (rigid(np.eye(3), np.array([-1.5, 0, 0.05])), Outcome.UNREACHABLE, "no joint angles"),
        (rigid(np.eye(3), np.array([-0.86, 0, 0.05])), Outcome.UNREACHABLE, ""),
    ],
)
def test_a_distant_pose_is_unreachable(arm, here, grip, outcome, words):
    blocked = ways_of(arm, here, grip=grip)
    assert not isinstance(blocked, Ways)
    assert blocked.outcome is outcome and words in blocked.detail


def test_a_collision_with_an_object_next_to_the_grip_is_predicted(arm, here):
    """A post is below the tube, but the start of the straight path is free of collisions."""
    place = GRIP[:3, 3] + 0.05 * GRIP[:3, 2]
    post = Obstacle(name="the heap", shape=coal.Sphere(0.02), T_base_shape=rigid(np.eye(3), place))
    blocked = ways_of(arm, here, heap=post)
    assert blocked.outcome is Outcome.COLLISION_SEEN and "the heap" in blocked.detail


@pytest.mark.slow
def test_a_shelf_above_a_part_stops_the_lift(arm, here):
    """The arm and the tip without a part would pass below the shelf; with the part they do not."""
    T = inverse(here.T_base_world) @ rigid(np.eye(3), GRIP[:3, 3] + [0, 0, 0.45])
    shelf = Obstacle(name="the heap", shape=coal.Box(0.5, 0.5, 0.02), T_base_shape=T)
    blocked = ways_of(arm, here, heap=shelf, up_m=0.3)
    assert blocked.outcome in (Outcome.COLLISION_SEEN, Outcome.UNREACHABLE)
    assert isinstance(ways_of(arm, here, up_m=0.3), Ways)
