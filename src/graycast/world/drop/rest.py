"""Simulate parts that fall and come to rest, in two stages.

Parts **fall** between walls that extend the bin's walls upwards, slightly damped, until no part
moves far. Then they **rest** in a new world without the speeds, forces or contacts of the fall,
without these walls, with nine tenths of the friction, and without damping. Only a part that leaves
its place is damped, until it rests again. So a heap at rest is stable without such aids.

Rest is defined by positions over time, not by an instantaneous speed. Damping replaces effects that
the engine does not model (rolling friction, bending, air). It is small at first and then grows, so
that rocking parts come to rest. Parts fall no faster than 1 m/s, as if lowered by hand.
"""

from collections import deque
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ...base.frames import transform_points
from ..scene import Bin, Layout
from .body import Body, Kinds, Poses, motion_m, parts_outside
from .rapier import RapierHeap, RapierPart, Terms, deepest_penetration_m, open_heap

LOOK_S = 0.04  # Poses are read at this interval.

# Clustered contacts take a quarter of the time; rocking parts come to rest in the second stage.
_FALL = Terms(guided=True, clustered=True)
FALLEN_MOTION_M, FALLEN_LOOKS = 5e-3, 3  # The fall ends when no part moved farther in 0.12 s.

# A heap that is stable at nine tenths of its friction does not depend on the last tenth.
_REST = Terms(friction=0.9)
# A part that moved farther than this in 0.6 s has left its place. Contact forces start from 0 when
# the stage begins, which shakes a balanced heap, but by less than this.
REST_MOTION_M, REST_LOOKS = 0.5e-3, 15
# A part rests in a new place if it moves no farther in 0.2 s; a scanner does not resolve this.
PLACE_MOTION_M, PLACE_LOOKS = 0.1e-3, 5
# A heap that moves by less than this in 0.2 s is at rest, without a wait of 0.6 s. An unstable
# motion grows e-fold in sqrt(l / g), 0.05 s for a part of 25 mm, from the first shake's 1 to 700
# um. Parts at rest vibrate: their motions of 0 to 6 um in 0.04 s do not add up.
STILL_MOTION_M = 10e-6

# One bolt of 255 may rock from edge to edge forever. While all parts fall, damping doubles every
# second from 2 s on; for a part that left its place, every 0.2 s from 0.4 s on. Even at 64 times
# the damping, no part hangs in the air: parts fall at 0.77 m/s and topple at once.
FALL_DAMPING_S = (2.0, 1.0)  # when damping starts, and the time in which it doubles
PART_DAMPING_S = (0.4, 0.2)
MOST_DAMPING = 64.0


def simulate(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Poses,
    part_index: Kinds,
    *,
    simulated_s: float,
) -> Layout:
    """Let parts fall from their start poses until they rest, or for `simulated_s`.

    At rest means: without guiding walls, without damping and with nine tenths of the friction, no
    point of a part moved by more than 0.5 mm in 0.6 s, or by more than 10 um in 0.2 s. So a part
    that leans over the rim falls off.

    Returns:
        The final state, which `flaws` checks. `deepest_penetration_m` is the deepest overlap of any
            two hulls of different parts, or of a hull and the bin.
    """
    kinds = [RapierPart.of(body) for body in bodies]
    box_m = np.stack([body.box_m for body in bodies])[part_index]
    heap = open_heap(_FALL, box, kinds, T_world_part, part_index)
    fallen, fall_s = _fall(heap, box_m, simulated_s)
    heap = open_heap(_REST, box, kinds, fallen, part_index)
    end, last_m, rest_s, at_rest = _rest(heap, box_m, simulated_s - fall_s)
    solids = [list(pieces_m) for pieces_m in heap.blocks]
    for T, kind in zip(end, part_index, strict=True):
        solids.append([transform_points(T, vertices) for vertices, _ in bodies[kind].hulls])
    return Layout(
        T_world_part=end,
        part_index=part_index,
        at_rest=at_rest,
        last_motion_m=last_m,
        deepest_penetration_m=deepest_penetration_m(heap.world, solids),
        outside=int(parts_outside(box, bodies, end, part_index).sum()),
        simulated_s=fall_s + rest_s,
    )


def resettle(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Poses,
    part_index: Kinds,
    *,
    keep: Bool[np.ndarray, " n"],
    simulated_s: float,
) -> tuple[Layout, Bool[np.ndarray, " n"]]:
    """Let some parts of a disturbed heap come to rest; the other parts are no longer there.

    Returns:
        The layout of the parts in the bin, and a mask of these among all parts of the arguments.
    """
    poses, index = T_world_part[keep], part_index[keep]
    if not len(index):
        return Layout(T_world_part=poses, part_index=index), keep
    rested = simulate(box, bodies, poses, index, simulated_s=simulated_s)
    inside = ~parts_outside(box, bodies, rested.T_world_part, index)
    layout = replace(
        rested, T_world_part=rested.T_world_part[inside], part_index=index[inside], outside=0
    )
    left = keep.copy()
    left[keep] = inside
    return layout, left


def _fall(
    heap: RapierHeap, box_m: Float[np.ndarray, "n 8 3"], patience_s: float
) -> tuple[Float[np.ndarray, "n 4 4"], float]:
    """Run until no part moves far or time is up; return the poses and the simulated time [s]."""
    poses = deque([heap.poses()], maxlen=1 + FALLEN_LOOKS)
    for look in range(1, 1 + _looks(patience_s)):
        heap.damp(np.full(len(box_m), _damping(look * LOOK_S, *FALL_DAMPING_S)))
        heap.run(LOOK_S)
        poses.append(heap.poses())
        if look >= FALLEN_LOOKS and motion_m(np.stack(poses), box_m).max() <= FALLEN_MOTION_M:
            break
    return poses[-1], look * LOOK_S


def _rest(
    heap: RapierHeap, box_m: Float[np.ndarray, "n 8 3"], patience_s: float
) -> tuple[Float[np.ndarray, "n 4 4"], float, float, bool]:
    """Run until the parts rest or time is up; return poses, last motion [m], time [s], and success.

    The last motion is measured over the last 0.6 s, or the last 0.2 s if these showed that all
    parts rest. A part that has left its place is damped until it rests in a new place.
    """
    poses = deque([heap.poses()], maxlen=1 + REST_LOOKS)
    damped_looks = np.zeros(len(box_m))  # for how many checks in a row each part was damped
    free_looks, rests, look = 0, False, 0
    while not rests and look < _looks(patience_s):
        look += 1
        factor = _damping(damped_looks * LOOK_S, *PART_DAMPING_S)
        heap.damp(np.where(damped_looks > 0, factor, 0.0))
        heap.run(LOOK_S)
        poses.append(heap.poses())
        away_m = motion_m(np.stack(poses), box_m)
        moved_m, lately_m = away_m.max(axis=0), away_m[-1 - PLACE_LOOKS :].max(axis=0)
        on_its_way = (moved_m > REST_MOTION_M) & (lately_m > PLACE_MOTION_M)
        damped_looks = np.where(on_its_way, damped_looks + 1, 0)
        free_looks = 0 if on_its_way.any() else free_looks + 1
        holds = free_looks >= REST_LOOKS and moved_m.max() <= REST_MOTION_M
        still = free_looks >= PLACE_LOOKS and lately_m.max() <= STILL_MOTION_M
        rests = bool(holds or still)
    last_m = lately_m if still else moved_m
    return poses[-1], float(last_m.max()), look * LOOK_S, rests


def _looks(seconds: float) -> int:
    return max(1, round(seconds / LOOK_S))


def _damping(
    time_s: Float[np.ndarray, " n"] | float, from_s: float, doubles_s: float
) -> np.ndarray | np.floating:
    """Return the factor of damping after some time [s], 1 to `MOST_DAMPING`."""
    return np.clip(2.0 ** ((time_s - from_s) / doubles_s), 1.0, MOST_DAMPING)
