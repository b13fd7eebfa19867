"""The contact of a tool with the true parts: the held part, or the reason why none is held."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ....base.frames import inverse, transform_points
from ....base.public_value import public_value
from ....world.drop import Hold
from ....world.parts import Mesh, Part
from ..outcome import Outcome

LoadLaw = Callable[[np.ndarray, np.ndarray], np.ndarray]  # the tool's `load_factor` in `grasp`


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class PartGrip:
    """A part held by a tool: the part's index, the hold, and the true pose of the tool's tip."""

    part: int
    hold: Hold
    T_world_tool: Float[np.ndarray, "4 4"]

    @staticmethod
    def of(
        part: int,
        T_world_part: Float[np.ndarray, "4 4"],
        T_world_tool: Float[np.ndarray, "4 4"],
        *,
        law: LoadLaw,
        stiffness_n_m: float,
    ) -> "PartGrip":
        """Return the grip of a tool on a part.

        Args:
            law: function that returns safety factors of forces [N] and moments [Nm], each (k, 3).
            stiffness_n_m: stiffness of the tool along each axis, in N/m.
        """

        def factor(force_n: np.ndarray, moment_nm: np.ndarray) -> float:
            return float(law(force_n[None], moment_nm[None])[0])

        hold = Hold(
            T_part_tool=inverse(T_world_part) @ T_world_tool,
            factor=factor,
            stiffness_n_m=stiffness_n_m,
        )
        return PartGrip(part=part, hold=hold, T_world_tool=T_world_tool)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class NoGrip:
    """The reason why a tool holds no part, and the part that it touched, if any."""

    outcome: Outcome
    detail: str = ""
    part: int | None = None


def near_parts(
    T_world_tool: Float[np.ndarray, "4 4"],
    parts: Sequence[Part],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, " n"],
    radius_m: float,
) -> Iterator[tuple[int, Mesh, Float[np.ndarray, "4 4"]]]:
    """Yield the number, the mesh and `T_part_tool` of each part near the tool's axis."""
    for number, (T, kind) in enumerate(zip(T_world_part, part_index, strict=True)):
        mesh = parts[kind].mesh
        low, high = mesh.bounds_m
        middle = transform_points(T, (low + high) / 2)
        aside = (inverse(T_world_tool) @ np.append(middle, 1.0))[:2]
        if np.linalg.norm(aside) <= np.linalg.norm(high - low) / 2 + radius_m:
            yield number, mesh, inverse(T) @ T_world_tool
