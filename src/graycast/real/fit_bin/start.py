"""Rough search for the bin on all planes that may be its floor, without a start pose.

A pose is scored along the rays: depth that agrees with the box counts for the pose, and depth
behind a face of the box counts against it, because the face would have hidden that surface. Missing
depth and depth in front of the box do not count. In this search, depth above the floor also counts
for the pose if it is inside the box or its walls: an empty table next to the bin may look like the
floor, but then the true walls are outside the box.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ...base.frames import axis_rotation, inverse, rigid, transform_points
from .bin_views import Grid
from .box import OpenBox, open_box
from .shape import is_floor

PLANES = 6  # The floor is one of the largest planes; others are the table and the walls.
_TRIALS = 400
_PLANE_M = 0.004  # largest distance of an inlier from its plane, including noise
_LEAST_SHARE = 0.02  # least share of all points on a plane
_YAW_STEP_RAD = np.radians(7.5)
_STEPS = 12  # number of steps over the shorter side of the box
_CONTENT = 1.0
_CLIMBERS = 200  # number of the best poses that are refined
_CENTRES = 2000  # approximate largest number of positions that are tried on one plane
_APART = 0.25  # Poses nearer than this share of the box's shorter side count as one.


def start_poses(
    box: OpenBox, grid: Grid, *, each: int, seed: int
) -> list[Float[np.ndarray, "4 4"]]:
    """Return likely poses `T_world_cam` of the box on each plane that may be its floor.

    Every plane is searched, because with coarse steps, an empty table around the bin may score
    higher than the floor. Poses on one plane are clearly different.

    Args:
        grid: a coarse grid.
        each: largest number of poses on a plane.
        seed: seed for the search for planes.
    """
    known = np.isfinite(grid.depth_m)
    ray, depth_m = grid.ray[known], grid.depth_m[known]
    inside = open_box(box.inner_m)  # A coarse grid does not resolve the thickness of walls.
    coarse_m = max(
        0.005, min(box.inner_m[:2]) / 2 / _STEPS
    )  # largest distance of a position from the grid

    def score(
        T_world_cam: Float[np.ndarray, "p 4 4"], step: int, floor_m: float
    ) -> Float[np.ndarray, " p"]:
        # The plane is known more precisely than the position on it.
        tolerance_m = np.where(is_floor(inside), floor_m, coarse_m)
        some, z = ray[::step], depth_m[::step]
        return inside.evidence(T_world_cam, some, z, tolerance_m, content=_CONTENT)

    starts = []
    for normal, offset_m in planes(grid.point_m, seed=seed):
        T_world_cam = _poses_on(box, grid.point_m[known], normal, offset_m)
        # A few rays exclude most poses. If the table is hardly lower than the floor, the fitted
        # plane is between the two: a larger tolerance accepts it, and refinement corrects it.
        likely = np.argsort(-score(T_world_cam, 24, 2 * _PLANE_M), kind="stable")
        T_world_cam = T_world_cam[likely[: 500 + len(likely) // 6]]
        likely = np.argsort(-score(T_world_cam, 4, 2 * _PLANE_M), kind="stable")[:_CLIMBERS]
        climbed, reached = _climbed(box, T_world_cam[likely], lambda T: score(T, 4, _PLANE_M))
        starts += _distinct(box, climbed[np.argsort(-reached, kind="stable")], each)
    return starts


def _climbed(
    box: OpenBox,
    T_world_cam: Float[np.ndarray, "p 4 4"],
    score: Callable[[Float[np.ndarray, "p 4 4"]], Float[np.ndarray, " p"]],
) -> tuple[Float[np.ndarray, "p 4 4"], Float[np.ndarray, " p"]]:
    """Improve each pose by smaller and smaller steps; return the poses and their scores.

    A grid that is coarse enough to be fast may miss the only pose in which floor and walls fit.
    """
    best, reached = T_world_cam.copy(), score(T_world_cam)
    for part in (0.5, 0.5, 0.25, 0.25, 0.125):
        for move in _moves(part * min(box.inner_m[:2]) / _STEPS, part * _PLANE_M, part):
            tried = move @ best
            value = score(tried)
            better = value > reached
            best[better], reached[better] = tried[better], value[better]
    return best, reached


def _moves(aside_m: float, up_m: float, part: float) -> list[Float[np.ndarray, "4 4"]]:
    """Return steps in both directions along x, y and z, and by a part of the yaw step about z."""
    ways = np.diag([aside_m, aside_m, up_m])
    shifts = [rigid(np.eye(3), sign * way) for way in ways for sign in (1, -1)]
    angles = [sign * part * _YAW_STEP_RAD for sign in (1, -1)]
    return shifts + [rigid(axis_rotation("z", angle), np.zeros(3)) for angle in angles]


def planes(
    point: Float[np.ndarray, "rows columns 3"], *, seed: int
) -> list[tuple[Float[np.ndarray, "3"], float]]:
    """Return the largest planes `n . p = d` of a cloud, largest first, with n towards the camera.

    RANSAC with triples of near points finds one plane after another. Each plane is fitted to its
    inliers, which are then removed from the cloud.

    Source: Fischler & Bolles, "Random sample consensus", 1981.
    """
    rng = np.random.default_rng(seed)
    rest = point[np.isfinite(point[..., 2])]
    least = _LEAST_SHARE * len(rest)
    candidate = _local_planes(point, rng)
    largest: list[tuple[np.ndarray, float]] = []
    while len(largest) < PLANES and len(candidate):
        near = np.abs(rest @ candidate[:, :3].T - candidate[:, 3]) < _PLANE_M
        support = near.sum(axis=0)
        if support.max() < max(least, 10):
            break
        mine = near[:, support.argmax()]
        for _ in range(2):
            normal, offset_m = _fitted(rest[mine])
            mine = np.abs(rest @ normal - offset_m) < _PLANE_M
        if mine.sum() < max(least, 10):
            break
        sign = 1.0 if offset_m < 0 else -1.0  # Normals point to the camera, which is at the origin.
        largest.append((sign * normal, sign * offset_m))
        rest = rest[~mine]
        candidate = candidate[support > 0]
    return largest


def _local_planes(
    point: Float[np.ndarray, "rows columns 3"], rng: np.random.Generator
) -> Float[np.ndarray, "n 4"]:
    """Return planes through random pixels and two pixels 1/30 of the picture below and right."""
    rows, columns = point.shape[:2]
    step = max(1, round(max(rows, columns) / 30))
    y = rng.integers(0, max(rows - step, 1), 4 * _TRIALS)
    x = rng.integers(0, max(columns - step, 1), 4 * _TRIALS)
    below, right = np.minimum(y + step, rows - 1), np.minimum(x + step, columns - 1)
    a, b, c = point[y, x], point[below, x], point[y, right]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    usable = np.isfinite(length) & (length > 0)
    normal = normal[usable] / length[usable, None]
    return np.column_stack([normal, (normal * a[usable]).sum(axis=1)])[:_TRIALS]


def _fitted(point: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    middle = point.mean(axis=0)
    normal = np.linalg.svd(point - middle, full_matrices=False)[2][2]
    return normal, float(normal @ middle)


def _poses_on(
    box: OpenBox, point: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"], offset_m: float
) -> Float[np.ndarray, "p 4 4"]:
    """Return poses with the box's floor on a plane, on a grid of positions and yaw angles."""
    T_plane_cam = _plane_frame(normal, offset_m)
    at = transform_points(T_plane_cam, point)
    on = at[np.abs(at[:, 2]) < _PLANE_M, :2]
    low, high = np.percentile(on, [2, 98], axis=0)
    step_m = min(box.inner_m[:2]) / _STEPS
    step_m = max(step_m, float(np.sqrt(np.prod(np.maximum(high - low, step_m)) / _CENTRES)))
    x, y = (np.arange(low[i], high[i] + step_m, step_m) for i in (0, 1))
    yaw = np.arange(0.0, 2 * np.pi / box.turns, _YAW_STEP_RAD)
    yaw, x, y = (grid.ravel() for grid in np.meshgrid(yaw, x, y))
    T_plane_world = np.tile(np.eye(4), (len(yaw), 1, 1))
    T_plane_world[:, 0, 0] = T_plane_world[:, 1, 1] = np.cos(yaw)
    T_plane_world[:, 1, 0], T_plane_world[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    T_plane_world[:, 0, 3], T_plane_world[:, 1, 3] = x, y
    return inverse(T_plane_world) @ T_plane_cam


def _plane_frame(normal: Float[np.ndarray, "3"], offset_m: float) -> Float[np.ndarray, "4 4"]:
    """Return `T_plane_cam`, with z along the normal and the origin nearest to the camera."""
    aside = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    aside /= np.linalg.norm(aside)
    R_plane_cam = np.stack([aside, np.cross(normal, aside), normal])
    return rigid(R_plane_cam, np.array([0.0, 0.0, -offset_m]))


def _distinct(
    box: OpenBox, T_world_cam: Float[np.ndarray, "p 4 4"], count: int
) -> list[Float[np.ndarray, "4 4"]]:
    """Return up to `count` poses, and leave out poses that are near an earlier pose."""
    apart_m = _APART * min(box.inner_m[:2])
    corner = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]) * np.array(box.inner_m) / 2
    distinct: list[Float[np.ndarray, "4 4"]] = []
    places_of_others: list[Float[np.ndarray, "corners 3"]] = []
    for T in T_world_cam:
        places = transform_points(inverse(T), corner)  # corners of the floor in the camera frame
        if all(_shift_m(places, other) > apart_m for other in places_of_others):
            distinct.append(T)
            places_of_others.append(places)
        if len(distinct) == count:
            break
    return distinct


def _shift_m(corners: np.ndarray, other: np.ndarray) -> float:
    """Return the largest distance [m] from a corner to the nearest corner of the other box."""
    apart = np.linalg.norm(corners[:, None] - other[None], axis=-1)
    return float(apart.min(axis=1).max())
