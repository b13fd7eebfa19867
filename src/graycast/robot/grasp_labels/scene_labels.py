"""Label the grips of one scene: their obstacles, and their success in simulated physics."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...base.frames import inverse
from ...base.streams import stream
from ...world.drop import lift
from ...world.drop.lift import STEP_S
from ..grasp import CARRIED_M_S2, Grip
from ..pick.arm.robot import Obstacle, tool_touches
from ..pick.outcome import Outcome
from ..pick.tool.contact import NoGrip, PartGrip
from ..pick.tool.tools import T_flange_tip
from ..pick.tool.touch import touch
from .label_options import Labelling
from .stored_world import GraspWorld, ScenePoses, around

CLEAR_M = 0.05
LIFT_M_S = 0.25  # default speed of straight motions in a robot's cell
STILL_S = 0.3  # time for which the tool must hold the part after the lift


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """The outcome of a grip in the physics simulation."""

    ended: str
    least_factor: float | None = None

    @property
    def success(self) -> bool:
        return self.ended == "held"


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspLabel:
    """A grip on an instance of a scene.

    `reach` names the obstacle with which the tool would collide; it is 'free' if there is none.
    `met` is the tool's contact with the parts. `ending` is None if the grip was not simulated.
    """

    instance: int
    grip: Grip
    T_world_tool: Float[np.ndarray, "4 4"]
    reach: str
    met: PartGrip | NoGrip | None
    ending: Ending | None = None


def label_scene(
    world: GraspWorld, heap: ScenePoses, labelling: Labelling, *, seed: int, scene_id: int
) -> tuple[GraspLabel, ...]:
    """Label all instances of a scene, one after the other.

    For each instance, half of the selected grips have a score above 0 and half have the score 0, if
    there are enough of each. Grips for the simulation are selected in the same way, from those
    whose `reach` is 'free'.
    """
    rng = stream(seed, scene_id)
    still = around(world, heap)
    labels = [
        _label(world, heap, still, number, grip)
        for number in range(len(heap.part_index))
        for grip in _selection(world, heap, labelling, number, rng)
    ]
    free = [i for i, label in enumerate(labels) if label.reach == "free"]
    scores = [labels[i].grip.score for i in free]
    for k in _half_and_half(scores, labelling.simulate, rng):
        label = labels[free[k]]
        labels[free[k]] = replace(label, ending=carry_out(world, heap, label))
    return tuple(labels)


def _selection(
    world: GraspWorld, heap: ScenePoses, labelling: Labelling, number: int, rng: np.random.Generator
) -> list[Grip]:
    """Return a selection of the grips on one instance whose axis does not lean too much."""
    up = heap.T_world_part[number, 2, :3]
    least = np.cos(np.radians(labelling.most_lean_deg))
    upright = [
        grip
        for grip in world.places[heap.part_index[number]]
        if up @ grip.T_part_tool[:3, 2] >= least
    ]
    scores = [grip.score for grip in upright]
    return [upright[k] for k in _half_and_half(scores, labelling.per_instance, rng)]


def _half_and_half(scores: Sequence[float], count: int, rng: np.random.Generator) -> list[int]:
    """Return `count` random indices, half with score 0; more of one half if the other is short."""
    order = rng.permutation(len(scores)).tolist()
    good = [k for k in order if scores[k] > 0]
    bad = [k for k in order if scores[k] == 0]
    goods = min(len(good), max(count - count // 2, count - len(bad)))
    return sorted(good[:goods] + bad[: count - goods])


def _label(
    world: GraspWorld, heap: ScenePoses, still: Sequence[Obstacle], number: int, grip: Grip
) -> GraspLabel:
    T_world_tool = heap.T_world_part[number] @ grip.T_part_tool
    T_world_flange = T_world_tool @ inverse(T_flange_tip(world.tool))
    hit = tool_touches(world.tool.pieces(grip.opening_m), T_world_flange, still)
    met = None
    if hit is None:
        met = touch(
            world.tool,
            T_world_tool,
            world.kinds,
            heap.T_world_part,
            heap.part_index,
            opening_m=grip.opening_m,
        )
    pushed = isinstance(met, NoGrip) and met.outcome is Outcome.COLLISION_UNSEEN
    reach = "part" if pushed else "free" if hit is None else hit.removeprefix("the ")
    return GraspLabel(instance=number, grip=grip, T_world_tool=T_world_tool, reach=reach, met=met)


def carry_out(world: GraspWorld, heap: ScenePoses, label: GraspLabel) -> Ending:
    """Simulate a grip: close the tool, lift straight up, and return whether the part is still held.

    The tool accelerates and brakes with `CARRIED_M_S2` and moves at up to `LIFT_M_S`. It rises by
    `CLEAR_M` more than the depth of the bin, so that a part from the floor clears the rim.
    """
    met = label.met
    if not isinstance(met, PartGrip):
        return Ending(ended=str(None if met is None else met.outcome))
    if met.part != label.instance:
        return Ending(ended="other part")
    lifted = lift(
        world.stock.bin,
        world.bodies,
        heap.T_world_part,
        heap.part_index,
        met.part,
        met.hold,
        straight_up(met.T_world_tool, world.stock.bin.inner_m[2] + CLEAR_M),
    )
    least = lifted.least_factor
    return Ending(
        ended="held" if lifted.lost_s is None else str(world.tool.lost),
        least_factor=float(least) if np.isfinite(least) else None,
    )


def straight_up(
    T_world_tool: Float[np.ndarray, "4 4"], rise_m: float
) -> Float[np.ndarray, "t 4 4"]:
    """Return the tool's pose at each time step of a lift: speeding up, braking, and rest."""
    gain_s = LIFT_M_S / CARRIED_M_S2
    whole_s = rise_m / LIFT_M_S + gain_s
    time_s = np.arange(0, whole_s + STILL_S, STEP_S)
    speed = np.interp(
        time_s, [0, gain_s, whole_s - gain_s, whole_s], [0, LIFT_M_S, LIFT_M_S, 0], right=0
    )
    height_m = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2 * STEP_S)])
    path = np.tile(T_world_tool, (len(time_s), 1, 1))
    path[:, 2, 3] += height_m
    return path
