"""Bending of a bin's mesh until its visible surface agrees with a scan.

A real bin differs from its drawing: walls bulge, floors sag. Each vertex moves along its camera ray
by the ratio of measured depth to the mesh's depth. The ratio is one smooth function of the ray, so
points on a ray keep their order: the mesh does not fold, and the outside of a wall moves together
with its inside.

Leaves out: surfaces hidden by parts, shadows or the bin itself, which take the ratio measured next
to them. The outside and the underside follow the inside along the ray, so the thickness of a wall
is not measured. Shape finer than `EDGE_M` and differences of `REACH_M` or more along the ray are
ignored; at a grazing angle, such differences are much smaller across the wall. A part flatter than
`REACH_M` is mistaken for the bin if it is at the same place in most views.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation, gaussian_filter, map_coordinates

from ...base.errors import GraycastError
from ...base.frames import inverse, pixel_grid, rigid, transform_points
from ...base.ply import WORLD_FRAME, header
from ...rig.meshdepth import visible_surface
from ...rig.optics import Optics, project, rays
from ...world.bins import inside_of
from ...world.parts import Mesh
from ...world.parts.builtin import CREASE_RAD
from ...world.parts.normals import crease_normals
from ...world.scene import Bin, bin_mesh
from .bin_views import BinView

EDGE_M = 8e-3  # Shorter edges are not split. This is also the standard deviation of the smoothing.
_LONGEST_M = 8 * EDGE_M  # Longer edges are always split, because a face is tested at few points.
_CURVED_M = 1e-4  # largest distance of a face from the smooth shape, about the noise of a pixel
# A bin differs from its model by several millimetres; parts and wrong surfaces differ by more.
REACH_M = 15e-3
# The median absolute deviation of a pixel's depth over the views may reach _AGREE_M or, because
# noise depends on the camera, _AGREE_USUAL times the usual deviation, whichever is larger.
_AGREE_M = 1e-3
_AGREE_USUAL = 5.0
_STEP_M = 5e-3  # At a depth edge, depth changes by this much more than between the pixels around.
_MARGIN_PX = 3  # Pixels this near to a depth edge or a part may mix two surfaces.
_LEAST_SIGMA_PX = 2.0
_LEAST_SHARE = 0.05  # If fewer of the mesh's pixels have depth near the mesh, the pose is wrong.
_COARSER = 0.01  # weight of the next coarser level, for places with little measured depth
_ROUNDS = 3  # One round flattens a bulge by 10 %; two more reduce this to 0.1 %.


def bend_bin(
    mesh: Mesh,
    T_world_cam: Float[np.ndarray, "4 4"],
    camera: Optics,
    depth_m: Float[np.ndarray, "h w"],
) -> Mesh:
    """Bend the mesh of a bin so that its visible surface agrees with the measured depth.

    Faces are split where they bend, down to edges of `EDGE_M`. A shared edge is split in both
    faces, so that a watertight mesh stays watertight. A pixel counts if its depth is within
    `REACH_M` of the mesh and it is not next to a depth edge of the mesh or to other objects.

    Args:
        mesh: the bin as drawn, in the world frame.
        T_world_cam: pose of the camera that measured the depth.
        camera: intrinsics of that camera.
        depth_m: z-depth [m] in the camera frame; NaN where nothing is measured.

    Returns:
        The bent mesh in the frame of `mesh`. Vertices outside the picture move with the nearest
        pixel, and vertices behind the camera stay. Bending does not change uv coordinates.

    Raises:
        ValueError: the depth has another size than the camera's picture.
        GraycastError: the measured depth is near the mesh at too few pixels.
    """
    expected_m = _cast(mesh, T_world_cam, camera)
    if expected_m.shape != depth_m.shape:
        sizes = [f"{s[1]} x {s[0]}" for s in (depth_m.shape, expected_m.shape)]
        raise ValueError(f"the depth is {sizes[0]} pixels, the camera's picture is {sizes[1]}")
    taken = _taken(expected_m, depth_m)
    if taken.sum() < _LEAST_SHARE * max(np.isfinite(expected_m).sum(), 1):
        raise GraycastError(
            f"the bin cannot be bent: fewer than {_LEAST_SHARE:.0%} of its pixels are measured "
            f"within {1e3 * REACH_M:.0f} mm of its mesh: check the pose and the mesh"
        )
    sigma_px = max(_LEAST_SIGMA_PX, EDGE_M * camera.fx_px / float(np.median(expected_m[taken])))
    bend = _Bend(T_world_cam=T_world_cam, camera=camera, log_ratio=np.zeros(depth_m.shape))
    bent = mesh
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore", divide="ignore"):
            left = np.log(depth_m / expected_m)
        counts = taken & _clear_of_steps(expected_m) & np.isfinite(left)
        more = _smooth(np.where(counts, left, 0.0), counts.astype(np.float64), sigma_px)
        bend = replace(bend, log_ratio=bend.log_ratio + more)
        split = _split(mesh, bend)
        bent = replace(split, vertices_m=split.vertices_m + bend.shift_m(split.vertices_m))
        expected_m = _cast(bent, T_world_cam, camera)
    if mesh.corner_normals is None:
        return bent
    normals = crease_normals(bent.vertices_m, bent.faces, CREASE_RAD)
    return replace(bent, corner_normals=normals)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BentBin:
    """A bent mesh and the camera's pose, in a frame whose origin is the middle of the bent floor.

    `before_m` and `after_m` contain the median and the 90th percentile of the absolute difference
    between measured depth and mesh, before and after bending.
    """

    mesh: Mesh
    T_world_cam: Float[np.ndarray, "4 4"]
    before_m: tuple[float, float]
    after_m: tuple[float, float]


def bent_bin(box: Bin, T_world_cam: Float[np.ndarray, "4 4"], views: Sequence[BinView]) -> BentBin:
    """Bend a bin to the median depth of all views of one camera; a box becomes a mesh.

    A pixel does not count if half of the views are far from the median, because the median may then
    be no surface: with a flat part in one of two views, it is halfway between part and bin.

    Raises:
        GraycastError: see `bend_bin`.
        MeshError: the bent mesh is no longer an open bin.
    """
    camera, depth_m = views[0].camera, _median_depth(views)
    mesh = bin_mesh(box)
    bent = bend_bin(mesh, T_world_cam, camera, depth_m)
    mesh_m = _cast(mesh, T_world_cam, camera)
    taken = _taken(mesh_m, depth_m)
    origin_m, _ = inside_of(bent)
    return BentBin(
        mesh=replace(bent, vertices_m=bent.vertices_m - origin_m),
        T_world_cam=rigid(np.eye(3), -origin_m) @ T_world_cam,
        before_m=_spread(depth_m, mesh_m, taken),
        after_m=_spread(depth_m, _cast(bent, T_world_cam, camera), taken),
    )


def mesh_bytes(mesh: Mesh) -> bytes:
    """Return a mesh in the world frame as a binary PLY [m], without uv coordinates and normals."""
    head = header(
        "binary_little_endian",
        [("double", name) for name in "xyz"],
        vertices=len(mesh.vertices_m),
        faces=len(mesh.faces),
        notes=[f"comment {WORLD_FRAME}"],
    )
    table = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corner", "<i4", 3)])
    table["count"], table["corner"] = 3, mesh.faces
    return head + mesh.vertices_m.astype("<f8").tobytes() + table.tobytes()


def _median_depth(views: Sequence[BinView]) -> Float[np.ndarray, "h w"]:
    depth_m = np.stack([view.depth_m for view in views])
    known = np.isfinite(depth_m).any(axis=0)
    median_m = np.full(known.shape, np.nan)
    median_m[known] = np.nanmedian(depth_m[:, known], axis=0)
    apart_m = np.nanmedian(np.abs(depth_m - median_m)[:, known], axis=0)
    limit_m = max(_AGREE_M, _AGREE_USUAL * float(np.median(apart_m)))
    median_m[known] = np.where(apart_m > limit_m, np.nan, median_m[known])
    return median_m


def _spread(
    depth_m: Float[np.ndarray, "h w"],
    mesh_m: Float[np.ndarray, "h w"],
    taken: Bool[np.ndarray, "h w"],
) -> tuple[float, float]:
    off_m = np.abs(depth_m - mesh_m)[taken & np.isfinite(mesh_m)]
    median_m, most_m = np.quantile(off_m, (0.5, 0.9)).tolist()
    return median_m, most_m


# --- valid pixels ---------------------------------------------------------------------------------


def _cast(
    mesh: Mesh, T_world_cam: Float[np.ndarray, "4 4"], camera: Optics
) -> Float[np.ndarray, "h w"]:
    """Return the z-depth [m] of the mesh in the camera's picture; NaN outside the mesh."""
    return visible_surface(T_world_cam, mesh.vertices_m, mesh.faces, camera)[1]


def _taken(
    mesh_m: Float[np.ndarray, "h w"], depth_m: Float[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels whose measured depth belongs to the bin."""
    # Pixels next to a gap are kept, because scans have small gaps everywhere.
    with np.errstate(invalid="ignore"):
        other = np.abs(depth_m - mesh_m) >= REACH_M
    known = np.isfinite(depth_m) & np.isfinite(mesh_m)
    return known & ~_widened(other) & _clear_of_steps(mesh_m)


def _clear_of_steps(z_m: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels that are not near a depth edge or the end of a surface.

    On a steep wall, depth changes evenly from pixel to pixel. A depth edge is therefore a change
    that exceeds the changes between the pixels on both sides of it.
    """
    z_m = np.nan_to_num(z_m)  # This makes the end of a surface a step to 0.
    return ~_widened(_steps(z_m) | _steps(z_m.T).T)


def _steps(z_m: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of both pixels at each jump in depth between horizontal neighbours."""
    fall = np.pad(np.abs(np.diff(z_m, axis=1)), ((0, 0), (1, 1)))
    jump = fall[:, 1:-1] > np.maximum(fall[:, :-2], fall[:, 2:]) + _STEP_M
    return np.pad(jump, ((0, 0), (1, 0))) | np.pad(jump, ((0, 0), (0, 1)))


def _widened(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    return binary_dilation(mask, np.ones((3, 3), dtype=bool), iterations=_MARGIN_PX)


# --- smoothing of the ratio over the picture ------------------------------------------------------


def _smooth(
    value: Float[np.ndarray, "h w"], weight: Float[np.ndarray, "h w"], sigma_px: float
) -> Float[np.ndarray, "h w"]:
    """Smooth by normalised convolution with a Gaussian; fill gaps from coarser pyramid levels.

    Each level has half the pixels per axis of the previous level, so its Gaussian reaches twice as
    far. Source: H. Knutsson & C.-F. Westin, "Normalized and differential convolution", 1993.

    Args:
        value: values to average.
        weight: weight of each pixel, from 0 to 1.
        sigma_px: standard deviation of the Gaussian, in pixels of each level.
    """
    total = gaussian_filter(value * weight, sigma_px, mode="constant")
    share = gaussian_filter(weight, sigma_px, mode="constant")
    if max(value.shape) <= 2 * sigma_px:
        return total / (share + _COARSER)
    pooled = _halved(weight)
    mean = _halved(value * weight) / np.where(pooled > 0, pooled, 1.0)
    # Coarse coordinates of the pixel centres: a coarse pixel covers two pixels per axis.
    y, x = (np.arange(size) / 2 - 0.25 for size in value.shape)
    coarse = map_coordinates(
        _smooth(mean, pooled, sigma_px), np.meshgrid(y, x, indexing="ij"), order=1, mode="nearest"
    )
    return (total + _COARSER * coarse) / (share + _COARSER)


def _halved(image: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "hh hw"]:
    """Return means over blocks of 2 x 2 pixels; beyond the border, pixels count as 0."""
    rows, columns = image.shape
    even = np.pad(image, ((0, rows % 2), (0, columns % 2)))
    return even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).mean(axis=(1, 3))


# --- the mesh ----------------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Bend:
    """Displacement of world points along their camera rays; depth is multiplied by a ratio."""

    T_world_cam: Float[np.ndarray, "4 4"]
    camera: Optics
    log_ratio: Float[np.ndarray, "h w"]

    def shift_m(self, point_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the shift of points; 0 behind the camera, outside the picture as at its border."""
        pixel = self._pixel(point_m)
        front = np.isfinite(pixel).all(axis=1)
        growth = np.zeros(len(pixel))
        place = pixel[front, ::-1].T
        growth[front] = np.expm1(map_coordinates(self.log_ratio, place, order=1, mode="nearest"))
        return growth[:, None] * (point_m - self.T_world_cam[:3, 3])

    def _pixel(self, point_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        point = transform_points(inverse(self.T_world_cam), point_m)
        height_px, width_px = self.log_ratio.shape
        # Outside the picture, lens distortion may map two rays to one pixel, so rays are clipped to
        # the picture's border before they are projected.
        border = pixel_grid(height_px, width_px)
        border = np.concatenate([border[[0, -1]].reshape(-1, 2), border[:, [0, -1]].reshape(-1, 2)])
        ray = rays(self.camera, border)[:, :2]
        z = np.where(point[:, 2] > 0, point[:, 2], np.nan)
        ideal = np.clip(point[:, :2] / z[:, None], ray.min(axis=0), ray.max(axis=0))
        pixel = project(self.camera, np.column_stack([ideal, np.ones(len(ideal))]))
        return np.clip(pixel, 0, [width_px - 1, height_px - 1])


# A face has corners 0 to 2; points 3 to 5 are the midpoints of its edges 01, 12 and 20. Each entry
# lists the faces that replace it; the index has the bits 1, 2 and 4 for the edges that are split.
_PIECES = (
    ((0, 1, 2),),
    ((0, 3, 2), (3, 1, 2)),
    ((0, 1, 4), (0, 4, 2)),
    ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
    ((0, 1, 5), (5, 1, 2)),
    ((0, 3, 5), (3, 1, 2), (3, 2, 5)),
    ((4, 2, 5), (0, 1, 4), (0, 4, 5)),
    ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
)


_STEPS = 4  # A face is compared with the smooth shape at a grid of points: steps per edge.
_WITHIN = np.array(
    [(i, j, _STEPS - i - j) for i in range(_STEPS + 1) for j in range(_STEPS + 1 - i)]
) / float(_STEPS)


def _split(mesh: Mesh, bend: _Bend) -> Mesh:
    """Return the same surface with smaller faces where it bends, and without shading normals.

    trimesh's `subdivide_to_size` may split an edge in only one of its two faces, which opens
    cracks. Here, an edge is split in both faces or not at all, and a face requests only the split
    of its longest edge, so that faces do not become slivers.
    Source: M.-C. Rivara, "Algorithms for refining triangular grids suitable for adaptive and
    multigrid techniques", 1984.
    """
    vertices_m, faces, uv = mesh.vertices_m, mesh.faces, mesh.corner_uv
    new = np.arange(len(faces))  # Faces to check; faces that were not split are not checked again.
    while True:
        edge, of_face = _edges(faces)
        length_m = np.linalg.norm(np.diff(vertices_m[edge], axis=1)[:, 0], axis=1)
        longest = of_face[new, length_m[of_face[new]].argmax(axis=1)]
        long = np.zeros(len(edge), dtype=bool)
        long[longest[_curved(vertices_m[faces[new]], length_m[longest], bend)]] = True
        if not long.any():
            return Mesh(vertices_m=vertices_m.copy(), faces=faces.copy(), corner_uv=uv)
        number = np.where(long, len(vertices_m) + np.cumsum(long) - 1, -1)
        vertices_m = np.concatenate([vertices_m, vertices_m[edge[long]].mean(axis=1)])
        middle = number[of_face]
        corner = np.concatenate([faces, middle], axis=1)
        pattern = (middle >= 0) @ np.array([1, 2, 4])
        owner, piece = _pieces(pattern)
        new = np.flatnonzero(pattern[owner] > 0)
        faces = np.take_along_axis(corner[owner], piece, axis=1)
        if uv is not None:
            both = np.concatenate([uv, (uv + np.roll(uv, -1, axis=1)) / 2], axis=1)
            uv = np.take_along_axis(both[owner], piece[..., None], axis=1)


def _curved(
    corner_m: Float[np.ndarray, "f 3 3"], longest_m: Float[np.ndarray, " f"], bend: _Bend
) -> Bool[np.ndarray, " f"]:
    """Return a mask of the faces that are too long or too far from the smooth shape."""
    curved = longest_m > _LONGEST_M
    candidates = np.flatnonzero(~curved & (longest_m > EDGE_M))
    point_m = np.einsum("pk,fki->fpi", _WITHIN, corner_m[candidates])
    exact_m = bend.shift_m(point_m.reshape(-1, 3)).reshape(point_m.shape)
    at_corner_m = bend.shift_m(corner_m[candidates].reshape(-1, 3)).reshape(-1, 3, 3)
    flat_m = np.einsum("pk,fki->fpi", _WITHIN, at_corner_m)
    curved[candidates] = (np.linalg.norm(exact_m - flat_m, axis=-1) > _CURVED_M).any(axis=1)
    return curved


def _edges(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "f 3"]]:
    """Return all edges once, lower vertex first, and the indices of each face's three edges."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edge, of_face = np.unique(ends, axis=0, return_inverse=True)
    return edge, of_face.reshape(-1, 3)


def _pieces(
    pattern: Int[np.ndarray, " f"],
) -> tuple[Int[np.ndarray, " g"], Int[np.ndarray, "g 3"]]:
    """Return each new face's former face (as an index) and its three corners (0 to 5)."""
    owners, pieces = [], []
    for kind, faces in enumerate(_PIECES):
        mine = np.flatnonzero(pattern == kind)
        owners.append(np.repeat(mine, len(faces)))
        pieces.append(np.tile(np.array(faces), (len(mine), 1)))
    return np.concatenate(owners), np.concatenate(pieces)
