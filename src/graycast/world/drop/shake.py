"""Simulate a jolt of the bin, after which its parts lie in other places."""

import numpy as np
from jaxtyping import Float

from ..scene import Bin
from .body import Body, Kinds, Poses
from .rapier import STEP_S, RapierPart, Terms, open_heap


def shake(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Poses,
    part_index: Kinds,
    *,
    stroke_m: Float[np.ndarray, "2"],
    steps: int,
) -> Poses:
    """Return the poses of the parts, relative to the bin, at the end of a jolt of the bin.

    The bin starts and ends at rest. It moves by `stroke_m` (x, y) with a constant acceleration in
    the first half of the steps of `STEP_S`, and brakes in the other half. The simulation moves with
    the bin, so that a part of mass m feels the force `-m a` at its centre of mass.
    """
    heap = open_heap(
        Terms(), box, [RapierPart.of(body) for body in bodies], T_world_part, part_index
    )
    half = max(steps // 2, 1)
    acceleration = np.array([*stroke_m, 0.0]) / (half * STEP_S) ** 2
    for step in range(2 * half):
        for number, kind in enumerate(part_index):
            body = bodies[kind]
            force_n = body.mass_kg * (-acceleration if step < half else acceleration)
            arm_m = heap.motion(number)[0][:3, :3] @ body.center_m
            heap.push(number, force_n, np.cross(arm_m, force_n))
        heap.run(STEP_S)
    return heap.poses()
