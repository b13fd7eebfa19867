"""An open box as flat rectangles: which of them a ray meets, and which lies nearest to a point.

World frame: origin in the middle of the inner floor, z up, so every rectangle lies across an axis.
"""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int

NO_FACE = -1
COS_ALIKE = 0.707  # of the largest angle between a point's normal and its face's


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenBox:
    """Rectangles from corner `low_m` to corner `high_m`; `axis` is the one that they lie across.

    `side` is the sign of the normal along it, towards where the face can be seen from.
    """

    inner_m: tuple[float, float, float]
    wall_m: float | None
    names: tuple[str, ...]
    low_m: Float[np.ndarray, "f 3"]
    high_m: Float[np.ndarray, "f 3"]
    axis: Int[np.ndarray, "f"]
    side: Float[np.ndarray, "f"]

    def __post_init__(self) -> None:
        for array in (self.low_m, self.high_m, self.axis, self.side):
            array.flags.writeable = False

    @property
    def offset_m(self) -> Float[np.ndarray, "f"]:
        """Where each face's plane cuts its axis."""
        return self.low_m[np.arange(len(self.axis)), self.axis]

    @property
    def normal(self) -> Float[np.ndarray, "f 3"]:
        return np.eye(3)[self.axis] * self.side[:, None]

    @property
    def is_floor(self) -> Bool[np.ndarray, "f"]:
        return np.array([name == "floor" for name in self.names])

    @property
    def turns(self) -> int:
        """Into how many equal turns about z the box maps itself: 4 of a square one, else 2."""
        return 4 if abs(self.inner_m[0] - self.inner_m[1]) <= 1e-3 else 2

    def facing(self, eye_m: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "f"]:
        """Which faces can be seen from a point."""
        return self.side * (eye_m[self.axis] - self.offset_m) > 0


def open_box(inner_m: tuple[float, float, float], wall_m: float | None = None) -> OpenBox:
    """Floor and four walls seen from inside; with `wall_m` the outside and the rim as well."""
    x, y, height = inner_m[0] / 2, inner_m[1] / 2, inner_m[2]
    faces = [("floor", (-x, -y, 0.0), (x, y, 0.0), 2, 1.0)]
    for name, sign in (("+", 1.0), ("-", -1.0)):
        faces.append((f"wall {name}x", (sign * x, -y, 0.0), (sign * x, y, height), 0, -sign))
        faces.append((f"wall {name}y", (-x, sign * y, 0.0), (x, sign * y, height), 1, -sign))
    if wall_m is not None:
        faces += _outside(x, y, height, wall_m)
    names, low, high, axis, side = zip(*faces, strict=True)
    corners = np.stack([np.array(low), np.array(high)])
    return OpenBox(
        inner_m=inner_m,
        wall_m=wall_m,
        names=names,
        low_m=corners.min(axis=0),
        high_m=corners.max(axis=0),
        axis=np.array(axis),
        side=np.array(side),
    )


def _outside(x: float, y: float, height: float, wall_m: float) -> list[tuple]:
    out_x, out_y = x + wall_m, y + wall_m
    faces = []
    for name, s in (("+", 1.0), ("-", -1.0)):
        faces += [
            (f"outside {name}x", (s * out_x, -out_y, -wall_m), (s * out_x, out_y, height), 0, s),
            (f"outside {name}y", (-out_x, s * out_y, -wall_m), (out_x, s * out_y, height), 1, s),
            (f"rim {name}x", (s * x, -out_y, height), (s * out_x, out_y, height), 2, 1.0),
            (f"rim {name}y", (-x, s * y, height), (x, s * out_y, height), 2, 1.0),
        ]
    return faces


def cast(
    box: OpenBox, T_world_cam: Float[np.ndarray, "4 4"], ray: Float[np.ndarray, "*n 3"]
) -> tuple[Int[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """What camera rays (unit z) meet first, from either side: the face, and its z-depth [m].

    `NO_FACE` and inf where a ray meets nothing.
    """
    eye, direction = T_world_cam[:3, 3], ray @ T_world_cam[:3, :3].T
    face = np.full(ray.shape[:-1], NO_FACE)
    nearest = np.full(ray.shape[:-1], np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for f, (a, offset) in enumerate(zip(box.axis, box.offset_m, strict=True)):
            t = (offset - eye[a]) / direction[..., a]
            meets = (t > 0) & (t < nearest)
            for b in {0, 1, 2} - {int(a)}:
                at = eye[b] + t * direction[..., b]
                meets &= (at >= box.low_m[f, b]) & (at <= box.high_m[f, b])
            nearest[meets] = t[meets]
            face[meets] = f
    return face, nearest


def nearest_face(
    box: OpenBox,
    point: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    facing: Bool[np.ndarray, "f"],
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """The nearest rectangle to each point and its distance [m].

    Of those that face the camera and lie within 45 degrees of the point's own normal; `NO_FACE` and
    inf where there is none.
    """
    return _nearest(point, normal, box.low_m, box.high_m, box.axis, box.side, facing)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker would wrap the function, which numba cannot compile
def _nearest(point, normal, low_m, high_m, axis, side, facing):
    face, distance_m = np.full(len(point), NO_FACE), np.full(len(point), np.inf)
    for i in range(len(point)):
        for f in range(len(facing)):
            if not facing[f] or side[f] * normal[i, axis[f]] < COS_ALIKE:
                continue
            squared = 0.0
            for k in range(3):
                beyond = max(low_m[f, k] - point[i, k], 0.0, point[i, k] - high_m[f, k])
                squared += beyond * beyond
            if squared < distance_m[i]:
                face[i], distance_m[i] = f, squared
    return face, np.sqrt(distance_m)


def height_over(
    box: OpenBox, point: Float[np.ndarray, "n 3"], face: Int[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Signed distance [m] of points from their face's plane, positive on its visible side."""
    along = point[np.arange(len(point)), box.axis[face]]
    return box.side[face] * (along - box.offset_m[face])
