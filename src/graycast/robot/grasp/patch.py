"""The surface under a tool, as heights above a plane perpendicular to the tool's axis.

The origin of a tool's frame is its target point; z points along the tool's axis, away from the
surface. A patch is a grid over x and y of the surface's heights along z, on which a suction cup
rests. Meshes and measured depth give the same kind of patch.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.frames import inverse, transform_points
from ...base.kernels import kernel
from ...rig.optics import Optics, project, rays
from ...world.parts import Mesh

STEP_M = 0.5e-3  # spacing of the grid nodes of a patch
_STEEPEST_RAD = math.radians(
    80
)  # A triangle that is steeper than this to the line of sight spans a gap and is ignored.


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """Heights [m] on a square grid about the tool's axis; NaN where no surface is known.

    Node [i, j] is at x = (j - n) * step_m and y = (i - n) * step_m; each side has 2 n + 1 nodes.
    """

    height_m: Float[np.ndarray, "n n"]
    step_m: float

    def __post_init__(self) -> None:
        self.height_m.flags.writeable = False

    @property
    def reach_m(self) -> float:
        """Distance from the axis to the edge of the grid, along x and y."""
        return (len(self.height_m) // 2) * self.step_m

    @property
    def node_m(self) -> Float[np.ndarray, "n n 2"]:
        """x and y coordinates of each node."""
        n = len(self.height_m) // 2
        y, x = np.mgrid[-n : n + 1, -n : n + 1] * self.step_m
        return np.stack([x, y], axis=-1)


def patch_of_mesh(
    mesh: Mesh,
    T_mesh_tool: Float[np.ndarray, "4 4"],
    *,
    radius_m: float,
    step_m: float,
) -> Patch:
    """Return the patch of a mesh under a tool: the highest surface along the tool's axis."""
    vertices = transform_points(inverse(T_mesh_tool), mesh.vertices_m.astype(np.float64))
    height = _nothing(radius_m, step_m)
    _highest_of_mesh(vertices[mesh.faces], step_m, height)
    return _patch(height, step_m)


def patch_of_depth(
    depth_m: Float[np.ndarray, "h w"],
    camera: Optics,
    T_cam_tool: Float[np.ndarray, "4 4"],
    *,
    radius_m: float,
    step_m: float,
) -> Patch:
    """Return the patch of a depth map, from triangles between neighbouring pixels.

    Heights are NaN where depth is missing. They are also NaN where a triangle is so steep to the
    line of sight that its pixels may show two different surfaces.

    Args:
        depth_m: z coordinate of each pixel in the camera's frame; NaN if it is missing.
    """
    rows, columns = _window(depth_m.shape, camera, T_cam_tool, 1.5 * radius_m)
    y, x = np.mgrid[rows, columns].astype(np.float64)
    point = rays(camera, np.stack([x, y], axis=-1)) * depth_m[rows, columns, None]
    height = _nothing(radius_m, step_m)
    here = transform_points(inverse(T_cam_tool), point)
    _highest_of_depth(point, here, math.cos(_STEEPEST_RAD), step_m, height)
    return _patch(height, step_m)


def _window(
    shape: tuple[int, ...], camera: Optics, T_cam_tool: Float[np.ndarray, "4 4"], radius_m: float
) -> tuple[slice, slice]:
    """Return the rows and columns of the pixels that see a ball around the tool's origin."""
    point = T_cam_tool[:3, 3]
    x, y = project(camera, point)
    wide = 2 + radius_m * max(camera.fx_px, camera.fy_px) / max(point[2] - radius_m, 1e-3)
    top, left = max(int(y - wide), 0), max(int(x - wide), 0)
    return (
        slice(top, max(min(int(y + wide) + 2, shape[0]), top)),
        slice(left, max(min(int(x + wide) + 2, shape[1]), left)),
    )


def _nothing(radius_m: float, step_m: float) -> Float[np.ndarray, "n n"]:
    """Return the heights of an empty grid, which are all -inf."""
    n = int(np.ceil(radius_m / step_m)) + 1
    return np.full((2 * n + 1, 2 * n + 1), -np.inf)


def _patch(height: Float[np.ndarray, "n n"], step_m: float) -> Patch:
    height[np.isinf(height)] = np.nan
    return Patch(height_m=height, step_m=step_m)


@kernel()
def _highest_of_mesh(corner, step_m, height):
    for f in range(len(corner)):
        _raise(corner[f, 0], corner[f, 1], corner[f, 2], step_m, height)


@kernel()
def _highest_of_depth(points, here, least_facing, step_m, height):
    """Raise `height` to the triangles between neighbouring pixels that belong to one surface.

    `points` are in the camera's frame; `here` are the same points in the tool's frame.
    """
    for i in range(points.shape[0] - 1):
        for j in range(points.shape[1] - 1):
            for (ai, aj), (bi, bj), (ci, cj) in (
                ((i, j), (i + 1, j), (i, j + 1)),
                ((i + 1, j + 1), (i, j + 1), (i + 1, j)),
            ):
                if _is_surface(points[ai, aj], points[bi, bj], points[ci, cj], least_facing):
                    _raise(here[ai, aj], here[bi, bj], here[ci, cj], step_m, height)


@kernel()
def _is_surface(a, b, c, least_facing):
    """Return whether a triangle in the camera's frame has depth and is not steep to its ray."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    x, y, z = (ax + bx + cx) / 3, (ay + by + cy) / 3, (az + bz + cz) / 3
    length = math.sqrt((nx**2 + ny**2 + nz**2) * (x**2 + y**2 + z**2))
    return abs(nx * x + ny * y + nz * z) > least_facing * length  # False if depth is missing


@kernel()
def _raise(a, b, c, step_m, height):
    """Raise the nodes that a triangle covers to its height; a node on an edge is covered."""
    n = len(height) // 2
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area == 0:
        return
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
                height[i + n, j + n] = max(height[i + n, j + n], wa * az + wb * bz + wc * cz)
