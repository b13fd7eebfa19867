"""The arm's obstacles as Coal shapes: bin, table, rig, and the measured heap.

The measured points become heights on a grid over the bin's floor. A node without a measurement
may hide a part, so its height is guessed as the largest height within `GUESSED_M` of the nearest
measured node. Hence a shadow next to a part is as high as the part, and the middle of a wide, dark
hole is as high as its rim. Isolated points, such as spikes, are ignored. Points on the bin's
walls are also ignored, because the bin is a separate obstacle; otherwise, guesses next to a wall
would be as high as the wall. Finally, each node gets the height of its highest neighbour, because
a scanner does not measure the edge of a part and because the grid rounds positions. A tool
therefore keeps a distance of `CELL_M`.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ....base.frames import inverse, rigid, transform_points
from ....rig.meshdepth import visible_surface
from ....rig.optics import Optics, picture_rays, points
from ....world.parts import Mesh
from ....world.scene import TABLE_HALF_M, Bin, Scene, bin_mesh, bin_of
from .robot import Obstacle

CELL_M = 4e-3
BESIDE = ndimage.generate_binary_structure(2, 1)  # a node and its four neighbours
GUESSED_M = 8e-3
NEIGHBOURS, STEP_M = 3, 6e-3  # A point needs this many neighbours with a smaller step in depth.
FLOOR_M = 3e-3  # Points less than this above the bin's floor belong to the floor.
WALL_M = 5e-3  # Points nearer than this to a wall belong to the wall.
BELOW_M = 0.05  # thickness of the table, and of the solid below the heap
RIG_M = 0.06  # margin of the box around the optical centres of camera and projector


def standing(scene: Scene, T_base_world: Float[np.ndarray, "4 4"]) -> tuple[Obstacle, ...]:
    """Return the obstacles that do not move: table, bin, and a box around the rig."""
    import coal

    box = bin_of(scene)
    table = rigid(np.eye(3), np.array([0.0, 0.0, -box.floor_m - BELOW_M / 2]))
    half = scene.rig.T_cam_proj[:3, 3] / 2
    low, high = np.minimum(half, -half) - RIG_M, np.maximum(half, -half) + RIG_M
    rig = scene.T_world_cam @ rigid(np.eye(3), half)
    return (
        Obstacle(
            name="the table",
            shape=coal.Box(2 * TABLE_HALF_M, 2 * TABLE_HALF_M, BELOW_M),
            T_base_shape=T_base_world @ table,
            carries=True,
        ),
        Obstacle(name="the bin", shape=triangles(bin_mesh(box)), T_base_shape=T_base_world),
        Obstacle(
            name="the rig",
            shape=coal.Box(*(high - low).tolist()),
            T_base_shape=T_base_world @ rig,
        ),
    )


def triangles(mesh: Mesh) -> Any:
    """Return the triangles of a mesh as a Coal shape, which only touches what meets its surface."""
    import coal

    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices_m))
    vertices = coal.StdVec_Vec3s()
    for vertex in mesh.vertices_m.astype(np.float64):
        vertices.append(vertex)
    faces = coal.StdVec_Triangle()
    for a, b, c in mesh.faces.tolist():
        faces.append(coal.Triangle(a, b, c))
    model.addSubModel(vertices, faces)
    model.endModel()
    return model


def hull(vertices_m: Float[np.ndarray, "v 3"]) -> Any:
    """Return the convex hull of points as a Coal shape."""
    import coal

    points = coal.StdVec_Vec3s()
    for vertex in vertices_m.astype(np.float64):
        points.append(vertex)
    return coal.Convex.convexHull(points, False, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredHeap:
    """Heights [m] above the bin's inner floor, on a grid in the world frame.

    Node [i, j] is at x = (j - (columns - 1) / 2) * CELL_M and y = (i - (rows - 1) / 2) * CELL_M.
    `is_measured` is true at nodes with a measured point.
    """

    height_m: Float[np.ndarray, "rows columns"]
    is_measured: Bool[np.ndarray, "rows columns"]

    def __post_init__(self) -> None:
        self.height_m.flags.writeable = False
        self.is_measured.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPoints:
    """The measured points [m, world frame] that may be on parts, and a mask of their pixels."""

    point_m: Float[np.ndarray, "n 3"]
    pixel: Bool[np.ndarray, "h w"]  # Its true pixels are in the order of `point_m`.
    box: Bin


def measured_points(
    depth_m: Float[np.ndarray, "h w"],
    camera: Optics,
    T_world_cam: Float[np.ndarray, "4 4"],
    box: Bin,
) -> MeasuredPoints:
    """Return the measured points, without spikes and without the walls of the bin.

    Args:
        depth_m: z coordinate of each pixel in the camera's frame; NaN if it is missing.
    """
    pixel = _supported(depth_m) & ~_of_wall(depth_m, camera, T_world_cam, box)
    point_m = transform_points(T_world_cam, points(camera, depth_m)[pixel])
    return MeasuredPoints(point_m=point_m, pixel=pixel, box=box)


def measured_heap(
    points: MeasuredPoints, *, without: Bool[np.ndarray, "h w"] | None = None
) -> MeasuredHeap:
    """Return the measured and guessed heights above the bin's floor.

    Args:
        without: pixels to ignore because they show the part that the fingers are to grip.
    """
    size_m = points.box.inner_m
    keep = np.s_[:] if without is None else ~without[points.pixel]
    point = points.point_m[keep]
    columns, rows = (int(np.ceil(size / CELL_M)) + 1 for size in size_m[:2])
    j = np.rint(point[:, 0] / CELL_M + (columns - 1) / 2).astype(np.int64)
    i = np.rint(point[:, 1] / CELL_M + (rows - 1) / 2).astype(np.int64)
    inside = (j >= 0) & (j < columns) & (i >= 0) & (i < rows)
    height = np.full((rows, columns), -np.inf)
    np.maximum.at(height, (i[inside], j[inside]), point[inside, 2])
    is_measured = np.isfinite(height)
    return MeasuredHeap(height_m=_guessed(height, is_measured, size_m[2]), is_measured=is_measured)


def heap_obstacle(heap: MeasuredHeap, T_base_world: Float[np.ndarray, "4 4"]) -> Obstacle:
    """Return a solid obstacle from `BELOW_M` under the floor to the heights of the heap."""
    import coal

    rows, columns = heap.height_m.shape
    # Coal's first row is at the largest y.
    field = coal.HeightFieldOBBRSS(
        (columns - 1) * CELL_M, (rows - 1) * CELL_M, np.ascontiguousarray(heap.height_m[::-1]),
        -BELOW_M,
    )  # fmt: skip
    return Obstacle(name="the heap", shape=field, T_base_shape=T_base_world)


def _of_wall(
    depth_m: Float[np.ndarray, "h w"],
    camera: Optics,
    T_world_cam: Float[np.ndarray, "4 4"],
    box: Bin,
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels that show a wall of the bin or its rim."""
    mesh = bin_mesh(box)
    face, z = visible_surface(T_world_cam, mesh.vertices_m, mesh.faces, camera)
    ray = picture_rays(camera)
    height_m = transform_points(T_world_cam, (ray * z[..., None]).reshape(-1, 3))[:, 2]
    normal = mesh.face_normal @ inverse(T_world_cam)[:3, :3].T
    off_m = np.abs((depth_m - z) * (ray * normal[face]).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        above = height_m.reshape(z.shape) > FLOOR_M
    return (face >= 0) & above & (off_m < WALL_M)


def _supported(depth_m: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels with at least `NEIGHBOURS` neighbours of similar depth."""
    padded = np.pad(depth_m, 1, constant_values=np.nan)
    h, w = depth_m.shape
    count = np.zeros(depth_m.shape, np.int64)
    for i, j in product(range(3), range(3)):
        if (i, j) != (1, 1):
            count += np.abs(padded[i : i + h, j : j + w] - depth_m) < STEP_M  # False for NaN
    return count >= NEIGHBOURS


def _guessed(
    height: Float[np.ndarray, "r c"], valid: Bool[np.ndarray, "r c"], rim_m: float
) -> Float[np.ndarray, "r c"]:
    if not valid.any():
        return np.full(height.shape, rim_m)  # Without measurements, the whole bin may be full.
    reach = int(np.ceil(GUESSED_M / CELL_M))
    around = ndimage.maximum_filter(height, size=2 * reach + 1, mode="nearest")
    nearest = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    whole = np.where(valid, height, around[tuple(nearest)])
    return np.asarray(ndimage.maximum_filter(whole, footprint=BESIDE, mode="nearest"))
