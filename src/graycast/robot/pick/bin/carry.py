"""Execute a grip: the tool grips, lifts and carries the part, and the other parts settle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ....base.frames import inverse
from ....score.evaluate.pose_errors import rotation_translation
from ....world.drop import Lift, lift, parts_outside, resettle
from ....world.drop.lift import STEP_S
from ....world.scene import Layout
from ..arm.robot import Joints
from ..arm.ways import Ways
from ..outcome import TAKEN, WRONG_M, WRONG_RAD, Outcome
from ..tool.contact import NoGrip, PartGrip
from ..tool.touch import touch
from .aim import Aim
from .choose import Choice
from .ready import Ready

FREED_M = 0.1  # Within this distance of a picked part, failed grips may be tried again.


@dataclass(frozen=True, slots=True, kw_only=True)
class BinState:
    """A bin between two attempts.

    `numbers` has the number of each part in the bin, in the layout's order. `hand_eye` maps planned
    poses of the tip to true poses (calibration error). `q` has the arm's joint angles. Grips failed
    at the places `tabu`; no path was found to the places `blocked`. A pick removes places near it.
    """

    layout: Layout
    numbers: Int[np.ndarray, " n"]
    hand_eye: Float[np.ndarray, "4 4"]
    q: Joints
    tabu: tuple[Float[np.ndarray, "3"], ...] = ()
    blocked: tuple[Float[np.ndarray, "3"], ...] = ()

    def without_way(self, places_m: Sequence[Float[np.ndarray, "3"]]) -> "BinState":
        """Return the state with additional places to which the arm found no path."""
        return replace(self, blocked=(*self.blocked, *places_m))

    def gripped(self, place_m: Float[np.ndarray, "3"], *, taken: bool) -> "BinState":
        """Return the state after a grip, with a new failed place or without places near a pick."""
        if not taken:
            return replace(self, tabu=(*self.tabu, place_m))
        tabu, blocked = (
            tuple(place for place in places if np.linalg.norm(place - place_m) > FREED_M)
            for places in (self.tabu, self.blocked)
        )
        return replace(self, tabu=tabu, blocked=blocked)


@dataclass(frozen=True, slots=True, kw_only=True)
class Carried:
    """The outcome of a grip; fields are as in `Attempt`, but `part` is an index in the layout."""

    outcome: Outcome
    detail: str = ""
    part: int | None = None
    pose_error: tuple[float, float] | None = None
    least_factor: float | None = None
    lost_s: float | None = None


def carry_out(ready: Ready, world: BinState, choice: Choice) -> tuple[Carried, BinState]:
    """Execute the chosen grip on the true parts; return its outcome and the new bin state."""
    layout, aim = world.layout, choice.aim
    met = touch(
        ready.tool,
        world.hand_eye @ aim.T_world_tool,
        ready.kinds,
        layout.T_world_part,
        layout.part_index,
        opening_m=aim.opening_m,
    )
    error = _pose_error(ready, layout, aim)
    world = replace(world, q=choice.ways.away.q[-1])
    if isinstance(met, NoGrip):
        carried = Carried(
            outcome=_blamed(met.outcome, error), detail=met.detail, part=met.part, pose_error=error
        )
        return carried, world.gripped(aim.place_m, taken=False)
    lifted = lift(
        ready.cell.box,
        ready.bodies,
        layout.T_world_part,
        layout.part_index,
        met.part,
        met.hold,
        _path(ready, choice.ways, met.T_world_tool),
    )
    outside = parts_outside(ready.cell.box, ready.bodies, lifted.T_world_part, layout.part_index)
    carried = _carried(ready, met, lifted, outside, error)
    gone = outside.copy()
    gone[met.part] |= lifted.lost_s is None
    settled, left = resettle(
        ready.cell.box,
        ready.bodies,
        lifted.T_world_part,
        layout.part_index,
        keep=~gone,
        simulated_s=ready.cell.config.drop.simulated_s,
    )
    after = replace(world, layout=settled, numbers=world.numbers[left])
    return carried, after.gripped(aim.place_m, taken=carried.outcome in TAKEN)


def _carried(
    ready: Ready,
    met: PartGrip,
    lifted: Lift,
    outside: Bool[np.ndarray, " n"],
    error: tuple[float, float] | None,
) -> Carried:
    others = int(outside.sum()) - int(outside[met.part])
    if lifted.lost_s is not None:
        outcome = _blamed(ready.tool.lost, error)
        pull, turn = np.linalg.norm(lifted.force_n), np.linalg.norm(lifted.moment_nm)
        detail = f"after {lifted.lost_s:.2f} s, by {pull:.1f} N and {turn:.2f} Nm"
    else:
        outcome = Outcome.TWO_AT_ONCE if others else Outcome.PICKED
        detail = f"{others} more" if others else ""
    return Carried(
        outcome=outcome,
        detail=detail,
        part=met.part,
        pose_error=error,
        least_factor=float(lifted.least_factor),
        lost_s=lifted.lost_s,
    )


def _path(
    ready: Ready, ways: Ways, T_world_tool: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "t 4 4"]:
    """Return the true poses of the tool with the part, one for each step of the physics engine.

    Args:
        T_world_tool: the tool's true pose at the start, which differs from the planned pose.
    """
    T_tip_true = inverse(ready.tip(ways.down.q[-1])) @ T_world_tool
    poses = []
    for way in ways.loaded:
        count = max(round(way.seconds / STEP_S), 1)
        poses += [ready.tip(way.at(way.seconds * i / count)) @ T_tip_true for i in range(count)]
    return np.stack(poses)


def _pose_error(ready: Ready, layout: Layout, aim: Aim) -> tuple[float, float] | None:
    """Return a grip's pose error relative to the nearest part of its kind; None if unknown."""
    if aim.T_cam_part is None or aim.target.kind is None:
        return None
    scene, kind = ready.cell.cell.scene, aim.target.kind
    T = scene.T_world_cam @ aim.T_cam_part
    alike = layout.T_world_part[layout.part_index == kind]
    if not len(alike):
        return None
    middle = scene.parts[kind].mesh.bounds_m.mean(axis=0)
    apart = np.linalg.norm((alike - T)[:, :3] @ np.append(middle, 1.0), axis=1)
    true = alike[int(np.argmin(apart))]
    return rotation_translation(T, true, ready.alike[kind], middle_m=middle)


def _blamed(outcome: Outcome, error: tuple[float, float] | None) -> Outcome:
    """Return `WRONG_POSE` if the pose was wrong, otherwise the outcome of the failed grip."""
    off = error is not None and (error[0] > WRONG_RAD or error[1] > WRONG_M)
    return Outcome.WRONG_POSE if off else outcome
