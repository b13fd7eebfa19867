"""Open box of flat rectangles: intersection with rays, and nearest rectangles to points.

World frame: origin in the middle of the inner floor, z up. Each rectangle is normal to an axis.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ...base.kernels import kernel
from .bin_views import Grid
from .shape import COS_ALIKE, NO_FACE, BinShape

# Contents are at least _RAISED_M above the floor; _AROUND_M leaves room for walls and pose errors.
_RAISED_M, _AROUND_M = 0.015, 0.025


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OpenBox:
    """Rectangles from corner `low_m` to corner `high_m`, perpendicular to `axis`.

    `side` is the sign of the normal along the axis; the normal is on the visible side.
    """

    inner_m: tuple[float, float, float]
    names: tuple[str, ...]
    low_m: Float[np.ndarray, "f 3"]
    high_m: Float[np.ndarray, "f 3"]
    axis: Int[np.ndarray, " f"]
    side: Float[np.ndarray, " f"]

    def __post_init__(self) -> None:
        for array in (self.low_m, self.high_m, self.axis, self.side):
            array.flags.writeable = False

    @property
    def surface(self) -> Int[np.ndarray, " f"]:
        return np.arange(len(self.names))

    @property
    def normal(self) -> Float[np.ndarray, "f 3"]:
        return np.eye(3)[self.axis] * self.side[:, None]

    @property
    def offset_m(self) -> Float[np.ndarray, " f"]:
        return self.side * self.low_m[np.arange(len(self.axis)), self.axis]

    @property
    def bounds_m(self) -> Float[np.ndarray, "2 3"]:
        return np.stack([self.low_m.min(axis=0), self.high_m.max(axis=0)])

    @property
    def turns(self) -> int:
        """Order of the rotational symmetry about z: 4 if the box is square, else 2."""
        return 4 if abs(self.inner_m[0] - self.inner_m[1]) <= 1e-3 else 2

    def nearest(
        self,
        point: Float[np.ndarray, "n 3"],
        normal: Float[np.ndarray, "n 3"],
        eye_m: Float[np.ndarray, "3"],
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        facing = self.normal @ eye_m > self.offset_m
        return _nearest(point, normal, self.low_m, self.high_m, self.axis, self.side, facing)

    def cast(
        self, T_world_cam: Float[np.ndarray, "4 4"], grid: Grid
    ) -> tuple[Int[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
        eye, direction = T_world_cam[:3, 3], grid.ray @ T_world_cam[:3, :3].T
        face = np.full(direction.shape[:-1], NO_FACE)
        nearest = np.full(direction.shape[:-1], np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for f, a in enumerate(self.axis):
                t = (self.low_m[f, a] - eye[a]) / direction[..., a]
                meets = (t > 0) & (t < nearest)
                for b in {0, 1, 2} - {int(a)}:
                    at = eye[b] + t * direction[..., b]
                    meets &= (at >= self.low_m[f, b]) & (at <= self.high_m[f, b])
                nearest[meets] = t[meets]
                face[meets] = f
        return face, nearest

    def votes(
        self, T_world_cam: Float[np.ndarray, "p 4 4"], grid: Grid, tolerance_m: float
    ) -> Float[np.ndarray, " p"]:
        known = np.isfinite(grid.depth_m)
        score = self.evidence(T_world_cam, grid.ray[known], grid.depth_m[known], tolerance_m)
        return known.sum() * score

    def evidence(
        self,
        T_world_cam: Float[np.ndarray, "p 4 4"],
        ray: Float[np.ndarray, "n 3"],
        depth_m: Float[np.ndarray, " n"],
        tolerance_m: float | Float[np.ndarray, " f"],
        *,
        content: float = 0.0,
    ) -> Float[np.ndarray, " p"]:
        """Return `votes` of each pose as a mean over rays (with z = 1) that all have depth.

        Args:
            tolerance_m: tolerance of each face, or one tolerance for all faces.
            content: additional value of a point that is above the floor and inside the box or its
                walls.
        """
        each_m = np.broadcast_to(np.float64(tolerance_m), len(self.names)).copy()
        faces = np.stack([self.low_m, self.high_m]), self.axis, each_m
        inner_m = np.array(self.inner_m)
        # Slices of a grid are not contiguous, so the kernel would be compiled again for them.
        views = [np.ascontiguousarray(values) for values in (T_world_cam, ray, depth_m)]
        return _evidence(*views, *faces, inner_m, content)


def stand_in(shape: BinShape) -> OpenBox:
    """Return the shape itself if it is a box, else a box of the same inner size."""
    return shape if isinstance(shape, OpenBox) else open_box(shape.inner_m)


def open_box(inner_m: tuple[float, float, float], wall_m: float | None = None) -> OpenBox:
    """Return a box with floor and four inner walls; with `wall_m`, also outer walls and rim."""
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


@kernel()
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


@kernel()
def _evidence(T_world_cam, ray, depth_m, corner_m, axis, tolerance_m, inner_m, content):
    low_m, high_m = corner_m[0], corner_m[1]
    score = np.zeros(len(T_world_cam))
    way = np.zeros(3)
    for p in range(len(T_world_cam)):
        T = T_world_cam[p]
        for i in range(len(ray)):
            for k in range(3):
                way[k] = T[k, 0] * ray[i, 0] + T[k, 1] * ray[i, 1] + T[k, 2] * ray[i, 2]
            nearest, tolerance = np.inf, 0.0
            for f in range(len(axis)):
                a = axis[f]
                if way[a] == 0:
                    continue
                t = (low_m[f, a] - T[a, 3]) / way[a]
                if t <= 0 or t >= nearest:
                    continue
                b, c = (a + 1) % 3, (a + 2) % 3
                at_b, at_c = T[b, 3] + t * way[b], T[c, 3] + t * way[c]
                if low_m[f, b] <= at_b <= high_m[f, b] and low_m[f, c] <= at_c <= high_m[f, c]:
                    nearest, tolerance = t, tolerance_m[f]
            behind_m = depth_m[i] - nearest
            if content > 0 and _raised_within(T, way, depth_m[i], inner_m):
                score[p] += content
            if nearest == np.inf:
                continue
            if behind_m > tolerance:
                score[p] -= 1
            elif behind_m > -tolerance:
                score[p] += 1 - abs(behind_m) / tolerance
    return score / len(ray)


@kernel()
def _raised_within(T, way, depth_m, inner_m):
    """Return whether the point on a ray is inside the box or its walls, and above the floor."""
    x, y = abs(T[0, 3] + depth_m * way[0]), abs(T[1, 3] + depth_m * way[1])
    z = T[2, 3] + depth_m * way[2]
    inside = x < inner_m[0] / 2 + _AROUND_M and y < inner_m[1] / 2 + _AROUND_M
    return inside and _RAISED_M < z < inner_m[2] + _RAISED_M
