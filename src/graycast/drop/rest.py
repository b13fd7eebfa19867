"""Parts fall and come to rest, in stages, until the heap holds by itself.

Rest is defined by positions over time, not by an instantaneous speed: see `REST_MOTION_M`. They
    fall
and settle between walls that stand on the bin's and guide them. Then all unphysical aids are
removed (`_LET_GO`), and the heap must be stable by itself. If it is not, it settles further
without the walls and is tested once more.

Damping replaces what the engine does not model (rolling friction, bending, air). It is small at
first and then grows, so that rocking parts come to rest. Parts fall no faster than 1 m/s, as if
let down by hand.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..frames import transform_points
from ..scene import Bin, Layout
from .body import Body, motion_m, parts_outside
from .rapier import Heap, Kind, Terms, deepest_penetration_m, open_heap

LOOK_S = 0.04  # poses are read this often
# A part that trembles on the spot by less than a scanner sees lies still; one that creeps does not.
REST_MOTION_M = 0.1e-3
REST_LOOKS = 10  # 0.4 s
# Let go for so long, a heap that is in balance moves less than this: contacts find their forces
# anew, which shakes it a little.
LET_GO_S = 0.6
LET_GO_MOTION_M = 0.5e-3
# One bolt of 255 may rock from edge to edge for ever. From 2 s on damping doubles every second, up
# to 64 times. Even so nothing hangs in the air: parts still fall at 0.77 m/s and topple at once.
DAMPING_GROWS_AFTER_S = 2.0
DAMPING_GROWTH = 64.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stage:
    """The conditions under which parts move, and when a damped stage ends.

    It ends where no point of a part was more than `motion_m` from where it is, for `looks` looks.
    """

    terms: Terms
    damped: bool = True
    motion_m: float = REST_MOTION_M
    looks: int = REST_LOOKS


_FALL = _Stage(terms=Terms(guided=True, clustered=True), motion_m=5e-3, looks=3)
_GUIDED = _Stage(terms=Terms(guided=True))
_OPEN = _Stage(terms=Terms())
# A heap that holds with nine tenths of its friction does not hang on the last of it.
_LET_GO = _Stage(terms=Terms(friction=0.9), damped=False)


def simulate(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    *,
    simulated_s: float,
    attempt: int = 0,
) -> Layout:
    """Lets parts fall from their start poses until they rest, or for `simulated_s`.

    At rest means: seen every 40 ms for 0.4 s, no point of a part was more than 0.1 mm from where
    it is at the end; and let go for 0.6 s, without the guiding walls, without damping and with
    nine tenths of the friction, no point moved by 0.5 mm. So what leans over the rim falls off.

    Returns:
        The final state without a verdict, which `flaws` gives. `deepest_penetration_m` is the
        deepest overlap of any two hulls of different parts, or of a hull and the bin.
    """
    kinds = [Kind.of(body) for body in bodies]
    box_m = np.stack([body.box_m for body in bodies])[part_index]
    end, time_s, last_m, stages = T_world_part, 0.0, np.inf, [_LET_GO, _GUIDED, _FALL]
    while stages and time_s < simulated_s:
        stage = stages.pop()
        heap = open_heap(stage.terms, box, kinds, end, part_index)
        end, last_m, stage_s, rests = (
            _until_rest(heap, box_m, stage, simulated_s - time_s)
            if stage.damped
            else _let_go(heap, box_m)
        )
        time_s += stage_s
        if not rests:
            stages += [stage] if stage.damped else [_LET_GO, _OPEN]
    solids = [list(block.pieces_m) for block in heap.blocks]
    for T, kind in zip(end, part_index, strict=True):
        solids.append([transform_points(T, vertices) for vertices, _ in bodies[kind].hulls])
    return Layout(
        T_world_part=end,
        part_index=part_index,
        at_rest=not stages,
        last_motion_m=last_m,
        deepest_penetration_m=deepest_penetration_m(heap.world, solids),
        outside=int(parts_outside(box, bodies, end, part_index).sum()),
        simulated_s=time_s,
        attempt=attempt,
    )


_End = tuple[Float[np.ndarray, "n 4 4"], float, float, bool]
"""Poses, how far a point moved last [m], simulated time [s], whether the parts rest."""


def _until_rest(
    heap: Heap, box_m: Float[np.ndarray, "n 8 3"], stage: _Stage, patience_s: float
) -> _End:
    """A damped stage: until it ends as it says, or patience does."""
    seen = deque([heap.poses()], maxlen=1 + stage.looks)
    for look in range(1, 1 + max(1, round(patience_s / LOOK_S))):
        growth = 2.0 ** (look * LOOK_S - DAMPING_GROWS_AFTER_S)
        heap.damp(min(max(growth, 1.0), DAMPING_GROWTH))
        heap.run(LOOK_S)
        seen.append(heap.poses())
        moved_m = float(motion_m(np.stack(seen), box_m).max())
        rests = look >= stage.looks and moved_m <= stage.motion_m
        if rests:
            break
    return seen[-1], moved_m, look * LOOK_S, rests


def _let_go(heap: Heap, box_m: Float[np.ndarray, "n 8 3"]) -> _End:
    """The last stage: for `LET_GO_S`, or until a part is on its way."""
    start = heap.poses()
    for look in range(1, 1 + round(LET_GO_S / LOOK_S)):
        heap.run(LOOK_S)
        now = heap.poses()
        moved_m = float(motion_m(np.stack([start, now]), box_m).max())
        if moved_m > LET_GO_MOTION_M:
            return now, moved_m, look * LOOK_S, False
    return now, moved_m, LET_GO_S, True
