"""The surface under a tool, as heights over a plane across the tool's axis.

A tool's frame has its origin where the tool is to touch, z along its axis away from the surface,
and x and y across. A patch says how high the surface lies along z, over x and y: what a suction cup
rests on, and what fingers meet. Meshes and measured depth give the same kind of patch.
"""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float

from ..frames import inverse, transform_points
from ..optics import Optics, project, rays
from ..parts import Mesh

STEP_M = 0.5e-3  # between the nodes under a tool that is tried


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """Heights [m] on a square grid about the tool's axis; NaN where no surface is, or is known.

    Node [i, j] stands at x = (j - n) * step_m and y = (i - n) * step_m, with 2 n + 1 nodes a side.
    """

    height_m: Float[np.ndarray, "n n"]
    step_m: float

    def __post_init__(self) -> None:
        self.height_m.flags.writeable = False

    def at(self, xy_m: Float[np.ndarray, "*k 2"]) -> Float[np.ndarray, "*k"]:
        """Heights between the nodes, bilinear; NaN beyond the grid or beside a missing node."""
        middle = len(self.height_m) // 2
        place = xy_m / self.step_m + middle
        low = np.floor(place).astype(np.int64)
        within = np.all((low >= 0) & (low < len(self.height_m) - 1), axis=-1)
        j, i = np.moveaxis(np.where(within[..., None], low, 0), -1, 0)
        u, v = np.moveaxis(place - low, -1, 0)
        h = self.height_m
        value = (1 - v) * ((1 - u) * h[i, j] + u * h[i, j + 1])
        value = value + v * ((1 - u) * h[i + 1, j] + u * h[i + 1, j + 1])
        return np.where(within, value, np.nan)

    @property
    def reach_m(self) -> float:
        """How far the grid goes from the axis along x and y."""
        return (len(self.height_m) // 2) * self.step_m

    @property
    def node_m(self) -> Float[np.ndarray, "n n 2"]:
        """x and y of each node."""
        n = len(self.height_m) // 2
        y, x = np.mgrid[-n : n + 1, -n : n + 1] * self.step_m
        return np.stack([x, y], axis=-1)

    def open_share(
        self, radius_m: float, about_m: Float[np.ndarray, "k 2"]
    ) -> Float[np.ndarray, " k"]:
        """The share of missing nodes within a radius about each place."""
        missing = np.isnan(self.height_m).ravel()
        if not missing.any():
            return np.zeros(len(about_m))
        node = self.node_m.reshape(-1, 2)
        inside = np.linalg.norm(node - about_m[:, None], axis=-1) <= radius_m * (1 + 1e-9)
        return (inside & missing).sum(axis=1) / inside.sum(axis=1)


def patch_of_mesh(
    mesh: Mesh,
    T_mesh_tool: Float[np.ndarray, "4 4"],
    *,
    radius_m: float,
    step_m: float,
) -> Patch:
    """The patch of a mesh under a tool: the highest surface along the tool's axis."""
    seen = transform_points(inverse(T_mesh_tool), mesh.vertices_m.astype(np.float64))
    return _patch(seen[mesh.faces], radius_m, step_m)


def patch_of_depth(
    depth_m: Float[np.ndarray, "h w"],
    camera: Optics,
    T_cam_tool: Float[np.ndarray, "4 4"],
    *,
    radius_m: float,
    step_m: float,
    steepest_rad: float = np.radians(80),
) -> Patch:
    """The patch of a depth map: triangles between neighbouring pixels.

    Where depth is missing, and where neighbours stand so steeply to the line of sight that they may
    be two surfaces, nothing is known.

    Args:
        depth_m: z of each pixel, NaN where it is missing.
        camera: its optics.
        steepest_rad: between a triangle's normal and the line of sight.
    """
    rows, columns = _window(depth_m.shape, camera, T_cam_tool, 1.5 * radius_m)
    near = depth_m[rows, columns]
    if min(near.shape) < 2:
        return _patch(np.zeros((0, 3, 3)), radius_m, step_m)
    y, x = np.mgrid[rows, columns].astype(np.float64)
    point = rays(camera, np.stack([x, y], axis=-1)) * near[..., None]
    corner = np.concatenate(
        [
            np.stack([point[:-1, :-1], point[1:, :-1], point[:-1, 1:]], axis=-2).reshape(-1, 3, 3),
            np.stack([point[1:, 1:], point[:-1, 1:], point[1:, :-1]], axis=-2).reshape(-1, 3, 3),
        ]
    )
    corner = corner[np.isfinite(corner).all(axis=(1, 2))]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    middle = corner.mean(axis=1)
    facing = np.abs(np.einsum("fi,fi->f", normal, middle))
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(middle, axis=1)
    corner = corner[facing > np.cos(steepest_rad) * length]
    return _patch(transform_points(inverse(T_cam_tool), corner), radius_m, step_m)


def _window(
    shape: tuple[int, ...], camera: Optics, T_cam_tool: Float[np.ndarray, "4 4"], radius_m: float
) -> tuple[slice, slice]:
    """Rows and columns about a ball round the tool's origin."""
    point = T_cam_tool[:3, 3]
    x, y = project(camera, point)
    wide = 2 + radius_m * max(camera.fx_px, camera.fy_px) / max(point[2] - radius_m, 1e-3)
    top, left = max(int(y - wide), 0), max(int(x - wide), 0)
    return (
        slice(top, max(min(int(y + wide) + 2, shape[0]), top)),
        slice(left, max(min(int(x + wide) + 2, shape[1]), left)),
    )


def _patch(corner: Float[np.ndarray, "f 3 3"], radius_m: float, step_m: float) -> Patch:
    n = int(np.ceil(radius_m / step_m)) + 1
    height = np.full((2 * n + 1, 2 * n + 1), -np.inf)
    _highest(np.ascontiguousarray(corner, np.float64), step_m, n, height)
    height[np.isinf(height)] = np.nan
    return Patch(height_m=height, step_m=step_m)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker would wrap the function, which numba cannot compile
def _highest(corner, step_m, n, height):
    """The highest point of all triangles above each node; a node on an edge belongs to both."""
    for f in range(len(corner)):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corner[f, 0], corner[f, 1], corner[f, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0:
            continue
        from_j = max(int(np.ceil(min(ax, bx, cx) / step_m)), -n)
        to_j = min(int(np.floor(max(ax, bx, cx) / step_m)), n)
        from_i = max(int(np.ceil(min(ay, by, cy) / step_m)), -n)
        to_i = min(int(np.floor(max(ay, by, cy) / step_m)), n)
        for i in range(from_i, to_i + 1):
            for j in range(from_j, to_j + 1):
                x, y = j * step_m, i * step_m
                wb = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
                wc = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
                wa = 1 - wb - wc
                if wa >= -1e-12 and wb >= -1e-12 and wc >= -1e-12:
                    z = wa * az + wb * bz + wc * cz
                    if z > height[i + n, j + n]:
                        height[i + n, j + n] = z
