"""Read a bin from a mesh file, turn it upright, place it at the world's origin, and measure it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..base.errors import MeshError
from .parts import Material, Mesh, load_mesh

Up = Literal["x", "-x", "y", "-y", "z", "-z"]

# Each matrix rotates the file's up axis to the world's z axis.
_TURNS = {
    "x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}
_CUTS = (
    -0.207,
    -0.093,
    0.011,
    0.113,
    0.193,
)  # Cuts at round shares of the width could run along edges.
_UPRIGHT = 0.9  # Least cosine between the floor's normal and z.
_INWARD = 0.7  # Least cosine between a wall's normal and the inward direction: 45 degrees.
_LEAST_DEPTH = 0.1  # A bin whose depth is a smaller share of its height is a plate.


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshBin:
    """A bin's mesh in the world: z up, the origin in the middle of the inner floor.

    `inner_m` is the bin's inner size, with length and width at half the depth; `material` comes
    from the file.
    """

    mesh: Mesh
    inner_m: tuple[float, float, float]
    material: Material
    notes: tuple[str, ...]


def load_bin(path: Path, *, unit: str | None, up: Up) -> MeshBin:
    """Return a bin from an OBJ, PLY, STL or GLB file.

    The floor is the median height of the upward faces in vertical cuts through the middle. Length
    and width are the distances between opposite walls in a horizontal cut at half the height, so a
    slanted wall is measured at half its height. Only the upward axis of the file's coordinate frame
    matters.

    Args:
        unit: see `load_mesh`.
        up: the file's axis that points out of the bin's opening.

    Raises:
        MeshError: see `load_mesh`; or the mesh has no floor with walls around it.
        ValueError: the unit is unknown.
    """
    mesh, material, findings = load_mesh(path, unit=unit)
    turned = _moved(mesh, np.array(_TURNS[up], dtype=np.float64), np.zeros(3))
    try:
        origin, (x, y, depth_m) = inside_of(turned)
    except _NoBin as error:
        raise MeshError(
            f"{path}: is not an open bin whose opening faces {up}: {error}; state with up_axis "
            f"which axis points out of the opening ({', '.join(_TURNS)})"
        ) from error
    size = " x ".join(f"{1e3 * length:.0f}" for length in (x, y, depth_m))
    bottom_m = float(origin[2] - turned.bounds_m[0, 2])
    text = f"{size} mm inside, and its floor is {1e3 * bottom_m:.1f} mm above the table"
    return MeshBin(
        mesh=_moved(turned, np.eye(3), -origin),
        inner_m=(x, y, depth_m),
        material=material,
        notes=(*findings, f"The bin is {text}."),
    )


def inside_of(mesh: Mesh) -> tuple[Float[np.ndarray, "3"], tuple[float, float, float]]:
    """Return the middle of an upright bin's inner floor [m], and the bin's inner size [m].

    Raises:
        MeshError: the mesh has no floor with walls around it.
    """
    floor_m = _floor_m(mesh)
    depth_m = float(mesh.bounds_m[1, 2]) - floor_m
    if depth_m < _LEAST_DEPTH * mesh.extent_m[2]:
        raise _NoBin("the middle is not lower than the top")
    low, high = _sides_m(mesh, floor_m + depth_m / 2).T
    x, y = (high - low).tolist()
    return np.array([*(low + high) / 2, floor_m]), (x, y, depth_m)


class _NoBin(MeshError):
    """An error for a mesh that is no bin; its text names the property that the mesh lacks."""


def _moved(mesh: Mesh, R: Float[np.ndarray, "3 3"], shift_m: Float[np.ndarray, "3"]) -> Mesh:
    normals = None if mesh.corner_normals is None else mesh.corner_normals @ R.T
    return replace(mesh, vertices_m=mesh.vertices_m @ R.T + shift_m, corner_normals=normals)


def _floor_m(mesh: Mesh) -> float:
    """Return the weighted median height of the upward faces in vertical cuts through the middle."""
    middle, extent = mesh.bounds_m.mean(axis=0), mesh.extent_m
    heights, lengths = [], []
    for across in (0, 1):
        along, normal = 1 - across, np.eye(3)[across]
        for cut in _CUTS:
            segment, face_normal = _cut(mesh, normal, middle + cut * extent * normal)
            floor = face_normal[:, 2] > _UPRIGHT
            inside = _within(segment[floor, :, along] - middle[along], extent[along] / 4)
            heights.append(segment[floor, :, 2].mean(axis=1))
            lengths.append(inside)
    return _median(np.concatenate(heights), np.concatenate(lengths), "no surface faces up")


def _sides_m(mesh: Mesh, height_m: float) -> Float[np.ndarray, "2 2"]:
    """Return the positions of the two walls that bound x, and of the two that bound y."""
    middle, extent = mesh.bounds_m.mean(axis=0), mesh.extent_m
    segment, normal = _cut(mesh, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, height_m]))
    sides = np.empty((2, 2))
    for across in (0, 1):
        along = 1 - across
        for k, sign in enumerate((-1, 1)):
            place = segment[:, :, across].mean(axis=1) - middle[across]
            wall = (sign * normal[:, across] < -_INWARD) & (sign * place > 0)
            inside = _within(segment[wall, :, along] - middle[along], extent[along] / 4)
            name = f"no wall is on its {'-+'[k]}{'xy'[across]} side at half its height"
            sides[across, k] = middle[across] + _median(place[wall], inside, name)
    return sides


def _cut(
    mesh: Mesh, normal: Float[np.ndarray, "3"], point_m: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 3"]]:
    """Return the segments in which a plane cuts the mesh, and the normals of their faces."""
    import trimesh

    shape = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    segment, face = trimesh.intersections.mesh_plane(shape, normal, point_m, return_faces=True)
    return segment, mesh.face_normal[face]


def _within(span_m: Float[np.ndarray, "n 2"], half_m: float) -> Float[np.ndarray, " n"]:
    """Return the length of the part of each span that is between -half and half."""
    low, high = np.clip(np.sort(span_m, axis=1), -half_m, half_m).T
    return high - low


def _median(value: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], if_none: str) -> float:
    """Return the weighted median; raise `_NoBin` if all weights are 0."""
    if not weight.sum() > 0:
        raise _NoBin(if_none)
    order = np.argsort(value, kind="stable")
    passed = np.cumsum(weight[order])
    return float(value[order][np.searchsorted(passed, passed[-1] / 2)])
