"""The true contact of a tool at its target: with the part, with its neighbours, or with nothing.

Only this module and `Tool.meet` use the true poses of the parts. If a rigid piece of a tool
penetrates a part by more than `PUSHED_M`, this is a collision that the scan did not predict.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ....base.frames import inverse
from ....world.drop import Body
from ....world.parts import Part
from ..arm.obstacles import hull
from ..outcome import Outcome
from .contact import NoGrip, PartGrip
from .tools import T_flange_tip, Tool

PUSHED_M = 2e-3  # If a tool penetrates a part by less than this, it pushes the part aside.


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactPart:
    """A kind of part for contact checks: the part with its mesh, and its convex hulls in Coal."""

    part: Part
    hulls: tuple[Any, ...]

    @staticmethod
    def of(part: Part, body: Body) -> "ContactPart":
        return ContactPart(part=part, hulls=tuple(hull(vertices) for vertices, _ in body.hulls))


def touch(
    tool: Tool,
    T_world_tool: Float[np.ndarray, "4 4"],
    kinds: Sequence[ContactPart],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    *,
    opening_m: float | None = None,
) -> PartGrip | NoGrip:
    """Return the contact of a tool at its target with the true parts.

    Args:
        T_world_tool: planned pose of the tip.
        T_world_part, part_index: true poses of the parts, and their kinds.
        opening_m: the grip's opening; if None, the tool is as open as it can be.
    """
    import coal

    T_world_flange = T_world_tool @ inverse(T_flange_tip(tool))
    request = coal.CollisionRequest()
    request.enable_contact = True
    for piece in tool.pieces(opening_m):
        T_piece = T_world_flange @ piece.T_flange_shape
        here = coal.Transform3s(T_piece[:3, :3], T_piece[:3, 3])
        for i, (T, index) in enumerate(zip(T_world_part, part_index, strict=True)):
            there = coal.Transform3s(T[:3, :3], T[:3, 3])
            for shape in kinds[index].hulls:
                result = coal.CollisionResult()
                if not coal.collide(piece.shape, here, shape, there, request, result):
                    continue
                deep_m = abs(result.getContact(0).penetration_depth)
                if deep_m > PUSHED_M:
                    return NoGrip(
                        outcome=Outcome.COLLISION_UNSEEN,
                        detail=f"the {piece.name} is pressed {1e3 * deep_m:.0f} mm into a part",
                        part=i,
                    )
    parts = [kind.part for kind in kinds]
    return tool.meet(T_world_tool, parts, T_world_part, part_index, opening_m)
