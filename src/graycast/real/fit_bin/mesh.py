"""Mesh of a bin as flat faces: visible faces in a picture, and nearest faces to points.

The direction of a face decides its surface: the inner floor, other faces that point up (rims and
ledges), and faces of the four walls that point to or away from the bin's middle.
"""

from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ...rig.meshdepth import visible_surface
from ...world.parts import Mesh
from ...world.scene import Bin, inner_floor
from .bin_views import Grid
from .shape import COS_ALIKE, NO_FACE

NAMES = (
    "floor",
    *(f"wall {side}" for side in ("+x", "+y", "-x", "-y")),
    *(f"outside {side}" for side in ("+x", "+y", "-x", "-y")),
    "rim and ledges",
    "underside",
)
_SAMPLES, _LEAST_SPACING_M = 200_000, 1e-3
_REACH_M = 0.05  # Faces farther away than this are ignored.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MeshShape:
    """Triangles in the world frame, with samples on them to find the nearest face to a point.

    A point's distance from the plane of the face is exact; its distance along the plane is as
    precise as the spacing of the samples, a few millimetres.
    """

    mesh: Mesh
    inner_m: tuple[float, float, float]
    names: tuple[str, ...]
    surface: Int[np.ndarray, " f"]
    normal: Float[np.ndarray, "f 3"]
    offset_m: Float[np.ndarray, " f"]
    axis: Int[np.ndarray, " f"]
    spacing_m: float
    # For each axis and sign of the normal: a tree of samples, and the face of each sample.
    trees: tuple[tuple[cKDTree, Int[np.ndarray, " _"]] | None, ...] = field(repr=False)

    @property
    def bounds_m(self) -> Float[np.ndarray, "2 3"]:
        return self.mesh.bounds_m

    def nearest(
        self,
        point: Float[np.ndarray, "n 3"],
        normal: Float[np.ndarray, "n 3"],
        eye_m: Float[np.ndarray, "3"],
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        face, distance_m = np.full(len(point), NO_FACE), np.full(len(point), np.inf)
        facing = self.normal @ eye_m > self.offset_m
        for way, tree in zip(_ways(normal), self.trees, strict=True):
            if tree is None or not way.any():
                continue
            samples, owner = tree
            gap_m, number = samples.query(point[way], distance_upper_bound=_REACH_M)
            met = np.isfinite(gap_m)
            mine = owner[np.where(met, number, 0)]
            height_m = (self.normal[mine] * point[way]).sum(axis=1) - self.offset_m[mine]
            aside_m = np.sqrt(np.maximum(gap_m**2 - height_m**2, 0))
            beyond_m = np.maximum(aside_m - self.spacing_m, 0)
            alike = (self.normal[mine] * normal[way]).sum(axis=1) > COS_ALIKE
            met &= alike & facing[mine]
            face[way] = np.where(met, mine, NO_FACE)
            distance_m[way] = np.where(met, np.hypot(height_m, beyond_m), np.inf)
        return face, distance_m

    def cast(
        self, T_world_cam: Float[np.ndarray, "4 4"], grid: Grid
    ) -> tuple[Int[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
        mesh = self.mesh
        face, z = visible_surface(T_world_cam, mesh.vertices_m, mesh.faces, grid.camera)
        return face, np.where(face == NO_FACE, np.inf, z)

    def votes(
        self, T_world_cam: Float[np.ndarray, "p 4 4"], grid: Grid, tolerance_m: float
    ) -> Float[np.ndarray, " p"]:
        known = np.isfinite(grid.depth_m)
        sums = []
        for T in T_world_cam:
            behind_m = grid.depth_m[known] - self.cast(T, grid)[1][known]
            agrees = np.maximum(1 - np.abs(behind_m) / tolerance_m, 0)
            sums.append(float(agrees.sum() - (behind_m > tolerance_m).sum()))
        return np.array(sums)


def mesh_shape(box: Bin) -> MeshShape:
    """Return the shape of a bin that has a mesh.

    Raises:
        ValueError: the bin is a box.
    """
    mesh = box.mesh
    if mesh is None:
        raise ValueError("the bin is a box, not a mesh: open_box gives its faces")
    corner = mesh.vertices_m[mesh.faces]
    area_m2, normal = mesh.face_area_m2, mesh.face_normal
    spacing_m = max(_LEAST_SPACING_M, float(np.sqrt(area_m2.sum() / _SAMPLES)))
    sample_m, owner = _spread(corner, area_m2)
    trees = []
    for way in _ways(normal[owner]):
        trees.append((cKDTree(sample_m[way]), owner[way]) if way.any() else None)
    return MeshShape(
        mesh=mesh,
        inner_m=box.inner_m,
        names=NAMES,
        surface=_surfaces(box, mesh, corner.mean(axis=1), normal),
        normal=normal,
        offset_m=(normal * corner[:, 0]).sum(axis=1),
        axis=np.abs(normal).argmax(axis=1),
        spacing_m=2 * spacing_m,
        trees=tuple(trees),
    )


def _ways(normal: Float[np.ndarray, "n 3"]) -> list[Bool[np.ndarray, " n"]]:
    """Return six masks of the normals that are nearest to +x, -x, +y, -y, +z and -z."""
    axis = np.abs(normal).argmax(axis=1)
    positive = normal[np.arange(len(normal)), axis] > 0
    return [(axis == a) & (positive == sign) for a in range(3) for sign in (True, False)]


def _spread(
    corner: Float[np.ndarray, "f 3 3"], area_m2: Float[np.ndarray, " f"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Sample points evenly on the mesh, add all centroids, and return also each point's face."""
    rng = np.random.default_rng(0)  # The seed is fixed, so that a fit depends only on its input.
    place = (np.arange(_SAMPLES) + rng.random(_SAMPLES)) / _SAMPLES
    owner = np.searchsorted(np.cumsum(area_m2) / area_m2.sum(), place).clip(0, len(corner) - 1)
    u, v = rng.random((2, _SAMPLES))
    root = np.sqrt(u)
    weight = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    point_m = np.einsum("nk,nki->ni", weight, corner[owner])
    every = np.arange(len(corner))
    return np.concatenate([point_m, corner.mean(axis=1)]), np.concatenate([owner, every])


def _surfaces(
    box: Bin, mesh: Mesh, middle_m: Float[np.ndarray, "f 3"], normal: Float[np.ndarray, "f 3"]
) -> Int[np.ndarray, " f"]:
    """Return, for each face, the index of its surface in `NAMES`."""
    axis = np.abs(normal).argmax(axis=1)
    each = np.arange(len(normal))
    sign = np.sign(normal[each, axis])
    place = middle_m[each, axis]
    # The normal of a wall on the positive side is negative where it points inwards.
    inward = sign * place < 0
    side = np.where(axis == 0, 0, 1) + np.where(place > 0, 0, 2)
    surface = np.where(inward, 1 + side, 5 + side)
    up, down = NAMES.index("rim and ledges"), NAMES.index("underside")
    surface = np.where(axis == 2, np.where(sign > 0, up, down), surface)
    return np.where(inner_floor(box, mesh), NAMES.index("floor"), surface)
