"""A grip, which is the pose of a tool on a part, and the directions in which a tool may lean."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.frames import rigid
from ...base.public_value import public_value

LEAN_RAD = np.radians(30)  # Walls and neighbouring parts force a tool to lean by about this angle.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Grip:
    """The pose of a tool in the part's frame, and the score of the grip (0 to 1).

    The tool's z points away from the part. `opening_m` is the distance between the open jaws.
    """

    T_part_tool: Float[np.ndarray, "4 4"]
    score: float
    opening_m: float | None = None

    def __post_init__(self) -> None:
        self.T_part_tool.flags.writeable = False


def best_first(places: Iterable[Grip]) -> list[Grip]:
    """Return the grips with a score above 0, sorted by descending score."""
    return sorted((grip for grip in places if grip.score > 0), key=lambda grip: -grip.score)


def frame_on(point_m: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> np.ndarray:
    """Return a tool's pose at a point: z is the normal, x is an arbitrary tangent direction."""
    least = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(least, normal)
    x /= np.linalg.norm(x)
    return rigid(np.stack([x, np.cross(normal, x), normal], axis=1), point_m)


def downs() -> Float[np.ndarray, "5 3"]:
    """Return unit vectors of gravity in the frame of an upright tool and of four leaning tools."""
    s, c = np.sin(LEAN_RAD), np.cos(LEAN_RAD)
    return np.array([[0, 0, -1], [s, 0, -c], [-s, 0, -c], [0, s, -c], [0, -s, -c]], dtype=float)
