"""The protocol of a tool (a gripper), and the kinds of tool in a configuration.

The tip's frame is the same as in `grasp`: its origin is at the point of contact, z points along the
axis back to the flange, and jaws close along x.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from ....base.frames import rigid
from ....world.drop import Body
from ....world.drop.rapier import GRAVITY_M_S2
from ....world.parts import Mesh, Part
from ...grasp import Doubt, Grip, SuctionSearch
from ..arm.robot import Mounted
from ..outcome import Outcome
from .contact import NoGrip, PartGrip
from .jaw_tool import JawTool
from .suction_tool import SuctionTool

AnyTool = Annotated[
    SuctionTool | JawTool,
    Field(discriminator="kind", description="The tool: a suction cup or jaws."),
]


@runtime_checkable
class Tool(Protocol):
    """A tool at the flange; other modules use tools only through this protocol.

    Attributes:
        lost: outcome of an attempt in which the tool loses the part while carrying it.
        is_round: whether the tool may be rotated about its axis by any angle; otherwise, only by
            half a turn.
        reaches_round: whether the tool encloses the part from the sides. If so, its shape depends
            on the grip, and measured points on the part are no obstacles.
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
        """Radius around the tip within which the measured surface must agree with the part.

        It is None for a tool that does not touch this surface.
        """
        ...

    @property
    def soft(self) -> tuple[Mesh, ...]:
        """Flexible shapes in the tip's frame, which appear in pictures and never collide."""
        ...

    def pieces(
        self, opening_m: float | None = None, *, closed: bool = False
    ) -> tuple[Mounted, ...]:
        """Return the rigid shapes of the tool.

        Args:
            opening_m: the opening of a grip; if None, the tool is as open as it can be.
            closed: whether the tool is closed on the part; otherwise, it has some clearance.
        """
        ...

    @property
    def on_mesh(self) -> Callable[..., list[Grip]]:
        """The search for grips on a mesh, such as `suction_places` without its argument `cup`."""
        ...

    def meet(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        parts: Sequence[Part],
        T_world_part: Float[np.ndarray, "n 4 4"],
        part_index: Int[np.ndarray, " n"],
        opening_m: float | None = None,
    ) -> PartGrip | NoGrip:
        """Return the contact of the tool with the true parts; its rigid shapes must not collide.

        Args:
            T_world_tool: planned pose of the tip.
            T_world_part, part_index: true poses of the parts, and their kinds.
            opening_m: the grip's opening; if None, the tool is as open as it can be.
        """
        ...


def T_flange_tip(tool: Tool) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the tip, which is straight below the flange; the z axes are opposite."""
    return rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, tool.length_m]))


def grips_on(tool: Tool, part: Part, body: Body, *, count: int) -> list[Grip]:
    """Return grips at about `count` places on a part, even those that do not hold."""
    weight_n = body.mass_kg * GRAVITY_M_S2
    return tool.on_mesh(
        part.mesh, weight_n=weight_n, center_m=body.center_m, doubt=Doubt(), count=count
    )
