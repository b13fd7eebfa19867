"""Tools at the flange: their settings, the pose of their tip, and their shapes.

The tip's frame is that of `grasp`: origin where the tool touches, z along the axis back towards the
flange, jaws close along x.
"""

from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from ...base.frames import rigid
from ...base.settings import Positive, Settings
from ...world.drop import Body
from ...world.drop.rapier import GRAVITY_M_S2
from ...world.parts import Part
from ..grasp import Cup, Doubt, Grip, Jaws, jaw_places, suction_places
from .robot import Mounted


class SuctionTool(Settings):
    """A suction cup at the end of a tube."""

    kind: Literal["suction"] = "suction"
    cup: Cup = Cup()
    length_m: Positive = Field(
        0.20, description="The distance from the flange to the lip of the cup, in metres."
    )
    tube_m: Positive = Field(
        0.012, description="The radius of the tube that carries the cup, in metres."
    )
    stroke_m: Positive = Field(
        0.010, description="The stroke of the spring in the cup's holder, in metres."
    )
    stiffness_n_m: Positive = Field(
        2000.0, description="The stiffness of the bellows along each axis [N/m]."
    )


class JawTool(Settings):
    """Two parallel fingers below a palm."""

    kind: Literal["jaws"]
    jaws: Jaws = Jaws()
    length_m: Positive = Field(
        0.16, description="The distance from the flange to the middle between the pads, in metres."
    )
    palm_m: tuple[Positive, Positive] = Field(
        (0.12, 0.06),
        description="The size of the palm along the closing axis and across it, in metres.",
    )
    stiffness_n_m: Positive = Field(
        20_000.0, description="The stiffness of the fingers along each axis [N/m]."
    )


Tool = SuctionTool | JawTool


def tool_places(tool: Tool, part: Part, body: Body, *, count: int) -> list[Grip]:
    """Where a tool goes on a part, also where it does not hold: `count` places are tried."""
    known: dict[str, Any] = {
        "weight_n": body.mass_kg * GRAVITY_M_S2,
        "center_m": body.center_m,
        "doubt": Doubt(),
        "count": count,
    }
    if isinstance(tool, SuctionTool):
        return suction_places(part.mesh, tool.cup, **known)
    return jaw_places(part.mesh, tool.jaws, **known)


def T_flange_tip(tool: Tool) -> Float[np.ndarray, "4 4"]:
    """The tip hangs straight below the flange; both axes z look at each other."""
    return rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, tool.length_m]))


def pieces(tool: Tool, *, opening_m: float | None = None) -> tuple[Mounted, ...]:
    """The rigid shapes of a tool, without the cup, which is compliant.

    Args:
        tool: at the flange.
        opening_m: between the pads of jaws; left out: as far as they open.
    """
    import coal

    if isinstance(tool, SuctionTool):
        # From the flange to where the bellows begin.
        long_m = max(tool.length_m - tool.cup.height_m - tool.stroke_m, 1e-3)
        tube = coal.Cylinder(tool.tube_m, long_m)
        return (_at("tube", tube, (0.0, 0.0, long_m / 2)),)
    thick, wide, long = tool.jaws.finger_m
    apart_m = tool.jaws.opening_m if opening_m is None else opening_m
    tip_m = tool.length_m + tool.jaws.pad_radius_m
    finger = coal.Box(thick, wide, long)
    aside_m, middle_m = (apart_m + thick) / 2, tip_m - long / 2
    palm_m = max(tip_m - long, 1e-3)
    palm = coal.Box(*tool.palm_m, palm_m)
    return (
        _at("palm", palm, (0.0, 0.0, palm_m / 2)),
        _at("finger", finger, (aside_m, 0.0, middle_m)),
        _at("other finger", finger, (-aside_m, 0.0, middle_m)),
    )


def _at(name: str, shape: Any, place_m: tuple[float, float, float]) -> Mounted:
    return Mounted(name=name, shape=shape, T_flange_shape=rigid(np.eye(3), np.array(place_m)))
