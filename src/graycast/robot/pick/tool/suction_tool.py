"""A suction cup on a tube: settings, and the methods of the protocol `tools.Tool`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from ....base.frames import rigid
from ....base.settings import Positive, Settings
from ....world.parts import Mesh, Part
from ...grasp import (
    Cup,
    Grip,
    Patch,
    SuctionSearch,
    load_factor,
    patch_of_mesh,
    seal,
    suction_places,
)
from ...grasp.patch import STEP_M
from ..arm.robot import Mounted
from ..outcome import Outcome
from .contact import NoGrip, PartGrip, near_parts
from .solids import ROUND


class SuctionTool(Settings):
    """A suction cup at the end of a tube."""

    kind: Literal["suction"] = Field(
        default="suction", description="The kind of the tool: suction."
    )
    cup: Cup = Cup()
    length_m: Positive = Field(
        default=0.20, description="The distance from the flange to the lip of the cup, in metres."
    )
    tube_m: Positive = Field(
        default=0.012, description="The radius of the tube that carries the cup, in metres."
    )
    stroke_m: Positive = Field(
        default=0.010, description="The stroke of the spring in the cup's holder, in metres."
    )
    stiffness_n_m: Positive = Field(
        default=2000.0, description="The stiffness of the bellows along each axis [N/m]."
    )

    lost: ClassVar[Outcome] = Outcome.LOST_SEAL
    is_round: ClassVar[bool] = True
    reaches_round: ClassVar[bool] = False

    @property
    def in_depth(self) -> Callable[..., SuctionSearch]:
        return partial(SuctionSearch, cup=self.cup)

    @property
    def ground_m(self) -> float:
        return self.cup.radius_m

    @property
    def soft(self) -> tuple[Mesh, ...]:
        """Mesh of the cup from the lip to its holder, in the tip's frame."""
        turn = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
        ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(ROUND)])
        top_m = np.array([0.0, 0.0, self.cup.height_m + self.stroke_m])
        vertices = np.vstack([self.cup.radius_m * ring, self.tube_m * ring + top_m])
        i = np.arange(ROUND)
        j = (i + 1) % ROUND
        faces = np.vstack([np.stack([i, j, ROUND + j], 1), np.stack([i, ROUND + j, ROUND + i], 1)])
        return (Mesh(vertices_m=vertices, faces=faces),)

    def pieces(
        self, opening_m: float | None = None, *, closed: bool = False
    ) -> tuple[Mounted, ...]:
        """Return the tube, which extends from the flange to the bellows."""
        import coal

        long_m = max(self.length_m - self.cup.height_m - self.stroke_m, 1e-3)
        tube = coal.Cylinder(self.tube_m, long_m)
        return (Mounted.at("tube", tube, (0.0, 0.0, long_m / 2)),)

    @property
    def on_mesh(self) -> Callable[..., list[Grip]]:
        return partial(suction_places, cup=self.cup)

    def meet(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        parts: Sequence[Part],
        T_world_part: Float[np.ndarray, "n 4 4"],
        part_index: Int[np.ndarray, " n"],
        opening_m: float | None = None,
    ) -> PartGrip | NoGrip:
        """Return the contact of the cup with the part that is under its centre."""
        height_m, number = self._under(T_world_tool, parts, T_world_part, part_index)
        middle = len(height_m) // 2
        part, at_m = int(number[middle, middle]), float(height_m[middle, middle])
        if part < 0 or at_m < -self.stroke_m:
            return NoGrip(outcome=Outcome.MISSED, detail="nothing is under the cup")
        if at_m > self.stroke_m:
            return NoGrip(
                outcome=Outcome.COLLISION_UNSEEN,
                detail=f"a part is {1e3 * at_m:.0f} mm higher than the target of the cup",
                part=part,
            )
        # The centre of the lip rests on the surface. Air leaks in across an edge to another part.
        patch = Patch(height_m=np.where(number == part, height_m - at_m, np.nan), step_m=STEP_M)
        lies = seal(self.cup, patch)
        if not lies.holds:
            how = (
                f"{lies.open_share:.0%} of the area under the cup has no surface"
                if lies.open_share
                else f"the springs of the cup would be strained by {lies.strain:.0%}"
            )
            return NoGrip(outcome=Outcome.NOT_HELD, detail=how, part=part)
        return PartGrip.of(
            part,
            T_world_part[part],
            T_world_tool @ rigid(np.eye(3), np.array([0.0, 0.0, at_m])),
            law=partial(load_factor, self.cup),
            stiffness_n_m=self.stiffness_n_m,
        )

    def _under(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        parts: Sequence[Part],
        T_world_part: Float[np.ndarray, "n 4 4"],
        part_index: Int[np.ndarray, " n"],
    ) -> tuple[Float[np.ndarray, "k k"], Int[np.ndarray, "k k"]]:
        """Return the heights under the cup, and the part's index at each node; -1 for no part."""
        radius_m = self.cup.radius_m
        size = 2 * (int(np.ceil(radius_m / STEP_M)) + 1) + 1
        height, number = np.full((size, size), np.nan), np.full((size, size), -1)
        for i, mesh, T in near_parts(T_world_tool, parts, T_world_part, part_index, radius_m):
            own = patch_of_mesh(mesh, T, radius_m=radius_m, step_m=STEP_M).height_m
            higher = np.isfinite(own) & ~(own <= height)
            height[higher], number[higher] = own[higher], i
        return height, number
