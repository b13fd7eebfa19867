"""Outcomes of grips that fail, and the memory of failed grips."""

from types import SimpleNamespace

import numpy as np
import pytest
from stage import BOX_CORNERS, box_part, lambert

from graycast.base.frames import axis_rotation, rigid
from graycast.robot.pick.arm.motion import Trajectory
from graycast.robot.pick.arm.ways import Ways
from graycast.robot.pick.bin import carry
from graycast.robot.pick.bin.aim import Aim, Candidate
from graycast.robot.pick.bin.carry import FREED_M, BinState, carry_out
from graycast.robot.pick.bin.choose import Choice
from graycast.robot.pick.bin.ready import Ready
from graycast.robot.pick.outcome import Outcome
from graycast.robot.pick.tool.contact import PartGrip
from graycast.robot.pick.tool.tools import SuctionTool
from graycast.robot.pick.tool.touch import NoGrip
from graycast.world.drop import Lift
from graycast.world.drop.lift import Hold
from graycast.world.parts import Mesh
from graycast.world.scene import Layout

EMPTY = BinState(
    layout=Layout(T_world_part=np.zeros((0, 4, 4)), part_index=np.zeros(0, int)),
    numbers=np.zeros(0, int),
    hand_eye=np.eye(4),
    q=np.zeros(6),
)
HERE = np.zeros(3)
NEAR, FAR = np.array([0.9 * FREED_M, 0.0, 0.0]), np.array([0.0, 1.1 * FREED_M, 0.0])


def test_a_failed_place_is_remembered_until_a_nearby_part_is_removed():
    failed = EMPTY.gripped(NEAR, taken=False).gripped(FAR, taken=False)
    assert failed.tabu == (NEAR, FAR)
    assert failed.gripped(HERE, taken=True).tabu == (FAR,)
    again = failed.gripped(HERE, taken=True).gripped(HERE, taken=True)
    assert again.tabu == (FAR,)
    assert again.gripped(HERE, taken=False).tabu == (FAR, HERE)


def test_a_place_without_a_path_is_remembered_despite_failures_elsewhere():
    blocked = EMPTY.without_way((NEAR,)).without_way((FAR,))
    assert blocked.blocked == (NEAR, FAR) and blocked.tabu == ()
    assert blocked.gripped(HERE, taken=True).blocked == (FAR,)
    assert blocked.gripped(HERE, taken=False).blocked == (NEAR, FAR)


# The first part has its centre 50 mm from its origin. The second part of the same kind is next to
# it. The third part, of another kind, is at the grip's pose.
MIDDLE = np.array([0.05, 0.0, 0.0])
MESH = Mesh(vertices_m=0.01 * BOX_CORNERS + MIDDLE, faces=box_part(1.0, lambert(0.5)).mesh.faces)
T_WORLD_CAM = rigid(axis_rotation("x", np.pi), np.array([0.1, 0.0, 0.9]))
POSES = [rigid(axis_rotation("z", 0.3), np.array([x, 0.02, 0.01])) for x in (0.0, 0.06, 0.005)]
HAND_EYE = rigid(axis_rotation("y", 0.01), np.array([0.001, -0.002, 0.0]))
JOINTS = Trajectory(time_s=np.arange(2.0), q=np.arange(12.0).reshape(2, 6))


@pytest.mark.parametrize(
    ("turn_deg", "shift_mm", "outcome"),
    [
        (0.0, 0.0, Outcome.MISSED),
        (9.0, 4.5, Outcome.MISSED),
        (11.0, 0.0, Outcome.WRONG_POSE),
        (0.0, 5.5, Outcome.WRONG_POSE),
    ],
)
def test_a_grip_that_misses_all_parts_is_attributed_to_a_wrong_pose(
    monkeypatch, turn_deg, shift_mm, outcome
):
    """The pose is rotated about the part's centre and shifted; limits are 10 degrees and 5 mm."""
    R = axis_rotation("z", np.radians(turn_deg))
    off = rigid(R, MIDDLE - R @ MIDDLE + [0, 0, shift_mm / 1e3])
    pose = Aim(
        T_world_tool=rigid(np.eye(3), np.array([0.2, 0.1, 0.05])), score=1.0,
        target=Candidate(kind=0, score=1.0, mask=np.ones((2, 2), bool)),
        T_cam_part=np.linalg.inv(T_WORLD_CAM) @ POSES[0] @ off,
    )  # fmt: skip
    scene = SimpleNamespace(T_world_cam=T_WORLD_CAM, parts=[SimpleNamespace(mesh=MESH)])
    cell = SimpleNamespace(
        cell=SimpleNamespace(scene=scene), config=SimpleNamespace(tool=SuctionTool())
    )
    picker = bare(Ready, cell=cell, kinds=(), alike=(np.eye(4)[None],))
    sent = []

    def touch(tool, T_world_tool, *_, **__):
        sent.append(T_world_tool)
        return NoGrip(outcome=Outcome.MISSED)

    monkeypatch.setattr(carry, "touch", touch)
    layout = Layout(T_world_part=np.stack(POSES), part_index=np.array([0, 0, 1]))
    world = BinState(layout=layout, numbers=np.arange(3), hand_eye=HAND_EYE, q=np.zeros(6))
    carried, after = carry_out(picker, world, Choice(aim=pose, ways=bare(Ways, away=JOINTS)))
    assert carried.outcome is outcome
    assert carried.pose_error == pytest.approx((np.radians(turn_deg), shift_mm / 1e3), abs=1e-9)
    np.testing.assert_allclose(sent, [HAND_EYE @ pose.T_world_tool])
    np.testing.assert_array_equal(after.tabu, [pose.place_m])
    np.testing.assert_array_equal(after.q, JOINTS.q[-1])


def bare(kind, **fields):
    """Return an object of a class that has only these fields."""
    result = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(result, name, value)
    return result


@pytest.mark.parametrize(
    ("outside", "lost_s", "error", "outcome", "detail", "left"),
    [
        ((False, True, False), None, None, Outcome.PICKED, "", (0, 2)),
        ((False, False, False), None, None, Outcome.PICKED, "", (0, 2)),  # held above the bin
        ((True, True, False), None, None, Outcome.TWO_AT_ONCE, "1 more", (2,)),
        ((False, False, False), 0.4, None, Outcome.LOST_SEAL, "after 0.40 s, by 5.0 N", (0, 1, 2)),
        ((False, True, False), 0.4, None, Outcome.LOST_SEAL, "after 0.40 s, by 5.0 N", (0, 2)),
        ((False, False, False), 0.4, (1.0, 0.0), Outcome.WRONG_POSE, "after 0.40 s", (0, 1, 2)),
    ],
)
def test_a_lift_removes_the_carried_part_and_parts_outside_the_bin(
    monkeypatch, outside, lost_s, error, outcome, detail, left
):
    """Part 1 is gripped; the carried part and parts outside the bin are removed."""
    lay = Layout(T_world_part=np.stack(POSES), part_index=np.array([0, 0, 1]))
    world = BinState(layout=lay, numbers=np.arange(3), hand_eye=np.eye(4), q=np.zeros(6))
    cell = SimpleNamespace(
        box=None, config=SimpleNamespace(tool=SuctionTool(), drop=SimpleNamespace(simulated_s=1.0))
    )
    ready = bare(Ready, cell=cell, kinds=(), bodies=())
    lifted = Lift(
        T_world_part=lay.T_world_part, lost_s=lost_s, least_factor=0.9,
        force_n=np.array([3.0, 0.0, 4.0]), moment_nm=np.zeros(3),
    )  # fmt: skip
    outside = np.array(outside)

    def resettle(box, bodies, T_world_part, index, *, keep, simulated_s):
        return Layout(T_world_part=T_world_part[keep], part_index=index[keep]), keep

    for name, instead in (
        ("touch", lambda *_, **__: PartGrip(part=1, hold=bare(Hold), T_world_tool=np.eye(4))),
        ("_pose_error", lambda *_: error),
        ("_path", lambda *_: np.eye(4)[None]),
        ("lift", lambda *_: lifted),
        ("parts_outside", lambda *_: outside),
        ("resettle", resettle),
    ):
        monkeypatch.setattr(carry, name, instead)
    pose = Aim(
        T_world_tool=rigid(np.eye(3), MIDDLE), score=1.0,
        target=Candidate(kind=0, score=1.0, mask=np.ones((2, 2), bool)),
    )  # fmt: skip
    carried, after = carry_out(ready, world, Choice(aim=pose, ways=bare(Ways, away=JOINTS)))
    assert (carried.outcome, carried.part, carried.lost_s) == (outcome, 1, lost_s)
    assert carried.detail.startswith(detail) and bool(carried.detail) == bool(detail)
    np.testing.assert_array_equal(after.numbers, left)
    assert len(after.layout.part_index) == len(left)
    assert bool(after.tabu) is (lost_s is not None)
