"""The true contact of a tool at its target: the part, its neighbours, or nothing.

Only this module uses the true poses of the parts. A cup is laid along its axis on the part that is
under its middle; jaws close until both pads touch. What stands in the way of a tool's stiff pieces
by more than `PUSHED_M` is a collision that the scanner did not show.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.frames import inverse, rigid, transform_points
from ...world.drop import Body, Hold
from ...world.parts import Part
from ..grasp import Patch, closing, jaw_load_factor, load_factor, patch_of_mesh, seal
from .obstacles import hull
from .outcome import Outcome
from .tools import JawTool, SuctionTool, T_flange_tip, Tool, pieces

PUSHED_M = 2e-3  # parts are nudged aside by less
STEP_M = 0.5e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """A tool that holds a part: which, how, and where its tip came to rest."""

    part: int
    hold: Hold
    T_world_tool: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NotHeld:
    """A tool that holds nothing: why, and the part that it met, if any."""

    outcome: Outcome
    detail: str = ""
    part: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of part as a tool meets it: its surface, and its hulls as Coal knows them."""

    part: Part
    hulls: tuple[Any, ...]

    @staticmethod
    def of(part: Part, body: Body) -> "Kind":
        return Kind(part=part, hulls=tuple(hull(vertices) for vertices, _ in body.hulls))


def touch(
    tool: Tool,
    T_world_tool: Float[np.ndarray, "4 4"],
    kinds: Sequence[Kind],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    *,
    opening_m: float | None = None,
) -> Held | NotHeld:
    """Move a tool to its target among the true parts.

    Args:
        T_world_tool: where its tip is sent.
        kinds: of parts.
        T_world_part, part_index: where parts lie, and their kinds.
        opening_m: between the pads of jaws before they close.
    """
    pushed = _pushed(tool, T_world_tool, kinds, T_world_part, part_index, opening_m)
    if pushed is not None:
        return pushed
    parts = [kind.part for kind in kinds]
    if isinstance(tool, SuctionTool):
        return _lay(tool, T_world_tool, parts, T_world_part, part_index)
    return _close(tool, T_world_tool, parts, T_world_part, part_index, opening_m)


def _pushed(
    tool: Tool,
    T_world_tool: Float[np.ndarray, "4 4"],
    kinds: Sequence[Kind],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    opening_m: float | None,
) -> NotHeld | None:
    """Collisions of the rigid shapes of a tool with the parts; None if there is none."""
    import coal

    T_world_flange = T_world_tool @ inverse(T_flange_tip(tool))
    request = coal.CollisionRequest()
    request.enable_contact = True
    for piece in pieces(tool, opening_m=opening_m):
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
                    return NotHeld(
                        outcome=Outcome.COLLISION_UNSEEN,
                        detail=f"the {piece.name} is pressed {1e3 * deep_m:.0f} mm into a part",
                        part=i,
                    )
    return None


def _lay(
    tool: SuctionTool,
    T_world_tool: Float[np.ndarray, "4 4"],
    parts: Sequence[Part],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
) -> Held | NotHeld:
    cup = tool.cup
    height_m, number = _under(T_world_tool, parts, T_world_part, part_index, cup.radius_m)
    middle = len(height_m) // 2
    part, at_m = int(number[middle, middle]), float(height_m[middle, middle])
    if part < 0 or at_m < -tool.stroke_m:
        return NotHeld(outcome=Outcome.MISSED, detail="nothing is under the cup")
    if at_m > tool.stroke_m:
        return NotHeld(
            outcome=Outcome.COLLISION_UNSEEN,
            detail=f"a part is {1e3 * at_m:.0f} mm higher than the target of the cup",
            part=part,
        )
    # The lip's middle comes to lie on the surface; over the edge to another part air gets in.
    patch = Patch(height_m=np.where(number == part, height_m - at_m, np.nan), step_m=STEP_M)
    lies = seal(cup, patch)
    if not lies.holds:
        how = (
            f"{lies.open_share:.0%} of the area under the cup has no surface"
            if lies.open_share
            else f"the springs of the cup would be strained by {lies.strain:.0%}"
        )
        return NotHeld(outcome=Outcome.NOT_HELD, detail=how, part=part)
    set_down = T_world_tool @ rigid(np.eye(3), np.array([0.0, 0.0, at_m]))
    return _held(tool, part, T_world_part[part], set_down, partial(load_factor, cup))


def _under(
    T_world_tool: Float[np.ndarray, "4 4"],
    parts: Sequence[Part],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    radius_m: float,
) -> tuple[Float[np.ndarray, "k k"], Int[np.ndarray, "k k"]]:
    """The highest surface under a tool, and whose it is; -1 is nobody's."""
    size = 2 * (int(np.ceil(radius_m / STEP_M)) + 1) + 1
    height, number = np.full((size, size), np.nan), np.full((size, size), -1)
    for i, (T, kind) in enumerate(zip(T_world_part, part_index, strict=True)):
        if not _near(T_world_tool, T, parts[kind], radius_m):
            continue
        own = patch_of_mesh(
            parts[kind].mesh, inverse(T) @ T_world_tool, radius_m=radius_m, step_m=STEP_M
        ).height_m
        higher = np.isfinite(own) & ~(own <= height)
        height[higher], number[higher] = own[higher], i
    return height, number


def _near(T_world_tool: np.ndarray, T_world_part: np.ndarray, part: Part, radius_m: float) -> bool:
    """Whether a part's bounding ball meets the cylinder about the tool's axis."""
    low, high = part.mesh.bounds_m
    middle = transform_points(T_world_part, (low + high) / 2)
    aside = (inverse(T_world_tool) @ np.append(middle, 1.0))[:2]
    return bool(np.linalg.norm(aside) <= np.linalg.norm(high - low) / 2 + radius_m)


def _close(
    tool: JawTool,
    T_world_tool: Float[np.ndarray, "4 4"],
    parts: Sequence[Part],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    opening_m: float | None,
) -> Held | NotHeld:
    jaws = tool.jaws
    met = []
    for i, (T, kind) in enumerate(zip(T_world_part, part_index, strict=True)):
        if _near(T_world_tool, T, parts[kind], jaws.opening_m):
            found = closing(parts[kind].mesh, jaws, inverse(T) @ T_world_tool, opening_m=opening_m)
            if found is not None:
                met.append((i, found))
    if not met:
        return NotHeld(outcome=Outcome.MISSED, detail="nothing is between the pads")
    if len(met) > 1:
        return NotHeld(
            outcome=Outcome.NOT_HELD, detail="two parts are between the pads", part=met[0][0]
        )
    part, (aside_m, slope) = met[0]
    if slope > jaws.friction:
        return NotHeld(
            outcome=Outcome.NOT_HELD,
            detail=f"the pads meet the part at a slope of {slope:.2f}, and the friction is "
            f"{jaws.friction:.2f}",
            part=part,
        )
    # The jaws close about the tool's middle: the part is drawn there, or the arm gives way.
    set_down = T_world_tool @ rigid(np.eye(3), np.array([aside_m, 0.0, 0.0]))
    return _held(tool, part, T_world_part[part], set_down, partial(jaw_load_factor, jaws))


def _held(
    tool: Tool,
    part: int,
    T_world_part: Float[np.ndarray, "4 4"],
    set_down: Float[np.ndarray, "4 4"],
    law: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Held:
    """A part in a tool with the law that gives the safety factor of a load."""

    def factor(force_n: np.ndarray, moment_nm: np.ndarray) -> float:
        return float(law(force_n[None], moment_nm[None])[0])

    hold = Hold(
        T_part_tool=inverse(T_world_part) @ set_down,
        factor=factor,
        stiffness_n_m=tool.stiffness_n_m,
    )
    return Held(part=part, hold=hold, T_world_tool=set_down)
