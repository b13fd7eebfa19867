"""Protocol of a tool (a gripper), and the tools that a file may choose.

The tip's frame is that of `grasp`: origin where the tool touches, z along the axis back towards the
flange, jaws close along x.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from ...base.frames import rigid
from ...world.drop import Body
from ...world.drop.rapier import GRAVITY_M_S2
from ...world.parts import Mesh, Part
from ..grasp import Doubt, Grip, SuctionSearch
from .contact import NoGrip, PartGrip
from .jaw_tool import JawTool
from .outcome import Outcome
from .robot import Mounted
from .suction_tool import SuctionTool

AnyTool = Annotated[
    SuctionTool | JawTool,
    Field(discriminator="kind", description="The tool: a suction cup or jaws."),
]


@runtime_checkable
class Tool(Protocol):
    """A tool at the flange; the rest of the program knows it only by this protocol.

    Attributes:
        lost: how an attempt ends in which the tool lets go on the way.
        is_round: whether the tool may be turned about its axis as one likes; otherwise by half a
            turn alone.
        reaches_round: whether it stands beside the part: then its shape is another for each grip,
            and what was measured of the part itself is not in its way.
    """

    lost: ClassVar[Outcome]
    is_round: ClassVar[bool]
    reaches_round: ClassVar[bool]

    @property
    def length_m(self) -> float:
        """Distance from the flange to the tip."""
        ...

    @property
    def in_depth(self) -> Callable[..., SuctionSearch] | None:
        """The search for grips on a measured surface; None for a tool that needs a known part.

        Its arguments are those of `SuctionSearch` without the cup.
        """
        ...

    @property
    def ground_m(self) -> float | None:
        """The radius about the tip within which the measured surface must be the part's.

        None for a tool that does not touch that surface.
        """
        ...

    @property
    def soft(self) -> tuple[Mesh, ...]:
        """Flexible shapes in the tip's frame; they appear in pictures and never collide."""
        ...

    def pieces(
        self, opening_m: float | None = None, *, closed: bool = False
    ) -> tuple[Mounted, ...]:
        """Return the rigid shapes at the flange.

        Args:
            opening_m: that of a grip; left out: the tool is as open as it can be.
            closed: whether the tool is at the part, or comes with some clearance.
        """
        ...

    @property
    def on_mesh(self) -> Callable[..., list[Grip]]:
        """The search for grips on a mesh, such as `suction_places` without its cup."""
        ...

    def meet(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        parts: Sequence[Part],
        T_world_part: Float[np.ndarray, "n 4 4"],
        part_index: Int[np.ndarray, " n"],
        opening_m: float | None = None,
    ) -> PartGrip | NoGrip:
        """Return the result when the tip arrives at the true parts, if no rigid shape collides.

        Args:
            T_world_tool: where the tip is sent.
            T_world_part, part_index: where parts lie, and their kinds.
            opening_m: that of the grip; left out: the tool is as open as it can be.
        """
        ...


def T_flange_tip(tool: Tool) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the tip, which is straight below the flange; their z axes are opposed."""
    return rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, tool.length_m]))


def grips_on(tool: Tool, part: Part, body: Body, *, count: int) -> list[Grip]:
    """Try `count` places on a part; return also those where the tool does not hold."""
    weight_n = body.mass_kg * GRAVITY_M_S2
    return tool.on_mesh(
        part.mesh, weight_n=weight_n, center_m=body.center_m, doubt=Doubt(), count=count
    )
