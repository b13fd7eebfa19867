"""Parallel jaws below a palm: settings, and the methods of the protocol `tools.Tool`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from ....base.frames import rigid
from ....base.settings import Positive, Settings
from ....world.parts import Mesh, Part
from ...grasp import CLEARANCE_M, Grip, Jaws, closing, jaw_load_factor, jaw_places
from ..arm.robot import Mounted
from ..outcome import Outcome
from .contact import NoGrip, PartGrip, near_parts


class JawTool(Settings):
    """Two parallel fingers below a palm."""

    kind: Literal["jaws"] = Field(description="The kind of the tool: jaws.")
    jaws: Jaws = Jaws()
    length_m: Positive = Field(
        default=0.16,
        description="The distance from the flange to the middle between the pads, in metres.",
    )
    palm_m: tuple[Positive, Positive] = Field(
        default=(0.12, 0.06),
        description="The size of the palm along the closing axis and across it, in metres.",
    )
    stiffness_n_m: Positive = Field(
        default=20_000.0, description="The stiffness of the fingers along each axis [N/m]."
    )

    lost: ClassVar[Outcome] = Outcome.SLIPPED
    is_round: ClassVar[bool] = False
    reaches_round: ClassVar[bool] = True
    in_depth: ClassVar[None] = None  # One finger touches a side that the camera cannot see.
    ground_m: ClassVar[None] = None  # The fingers need no flat surface of the part.
    soft: ClassVar[tuple[Mesh, ...]] = ()

    def _open_m(self, opening_m: float | None) -> float:
        """Return the distance between the open pads before they close on a part of this width."""
        return self.jaws.opening_m if opening_m is None else opening_m + 2 * CLEARANCE_M

    def pieces(
        self, opening_m: float | None = None, *, closed: bool = False
    ) -> tuple[Mounted, ...]:
        """Return the palm and both fingers."""
        import coal

        thick, wide, long = self.jaws.finger_m
        apart_m = opening_m if closed and opening_m is not None else self._open_m(opening_m)
        tip_m = self.length_m + self.jaws.pad_radius_m
        finger = coal.Box(thick, wide, long)
        aside_m, middle_m = (apart_m + thick) / 2, tip_m - long / 2
        palm_m = max(tip_m - long, 1e-3)
        palm = coal.Box(*self.palm_m, palm_m)
        return (
            Mounted.at("palm", palm, (0.0, 0.0, palm_m / 2)),
            Mounted.at("finger", finger, (aside_m, 0.0, middle_m)),
            Mounted.at("other finger", finger, (-aside_m, 0.0, middle_m)),
        )

    @property
    def on_mesh(self) -> Callable[..., list[Grip]]:
        return partial(jaw_places, jaws=self.jaws)

    def meet(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        parts: Sequence[Part],
        T_world_part: Float[np.ndarray, "n 4 4"],
        part_index: Int[np.ndarray, " n"],
        opening_m: float | None = None,
    ) -> PartGrip | NoGrip:
        """Return the result of closing the jaws until both pads touch a part."""
        jaws, open_m = self.jaws, self._open_m(opening_m)
        met = []
        near = near_parts(T_world_tool, parts, T_world_part, part_index, jaws.opening_m)
        for i, mesh, T_part_tool in near:
            contact = closing(mesh, jaws, T_part_tool, opening_m=open_m)
            if contact is not None:
                met.append((i, contact))
        if not met:
            return NoGrip(outcome=Outcome.MISSED, detail="nothing is between the pads")
        if len(met) > 1:
            return NoGrip(
                outcome=Outcome.NOT_HELD, detail="two parts are between the pads", part=met[0][0]
            )
        part, contact = met[0]
        if contact.slope > jaws.friction:
            return NoGrip(
                outcome=Outcome.NOT_HELD,
                detail=f"the pads meet the part at a slope of {contact.slope:.2f}, and the "
                f"friction is {jaws.friction:.2f}",
                part=part,
            )
        if not contact.on_pads:
            return NoGrip(
                outcome=Outcome.NOT_HELD,
                detail=f"a finger meets the part {1e3 * contact.ahead_m:.1f} mm before its pad",
                part=part,
            )
        # Closing jaws centre the part, or the arm yields; both centre the tool on the part.
        return PartGrip.of(
            part,
            T_world_part[part],
            T_world_tool @ rigid(np.eye(3), np.array([contact.aside_m, 0.0, 0.0])),
            law=partial(jaw_load_factor, jaws),
            stiffness_n_m=self.stiffness_n_m,
        )
