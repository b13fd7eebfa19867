"""Rigid bodies that fall, one for each kind of part, and the check that parts are in the bin."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from ..parts import Part
from ..scene import Bin
from .decomposition import Hull

Poses = Float[np.ndarray, "n 4 4"]  # poses of parts in the world
Kinds = Int[np.ndarray, " n"]  # the kind of each part


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """One kind of part as a rigid body of the physics engine, in the part's frame.

    Mass, centre of mass and inertia are those of the evenly filled mesh, not of the hulls.
    """

    hulls: tuple[Hull, ...]
    volume_m3: float
    mass_kg: float
    center_m: Float[np.ndarray, "3"]
    inertia_kg_m2: Float[np.ndarray, "3 3"]  # about the centre, along the part's axes
    friction: float

    def __post_init__(self) -> None:
        self.center_m.flags.writeable = False
        self.inertia_kg_m2.flags.writeable = False

    @property
    def box_m(self) -> Float[np.ndarray, "8 3"]:
        """Corners of the box around the hulls; no point of the part moves farther than a corner."""
        vertices = np.vstack([vertices for vertices, _ in self.hulls])
        spans = zip(vertices.min(axis=0), vertices.max(axis=0), strict=True)
        return np.array(list(product(*spans)))


def body_of(part: Part, hulls: tuple[Hull, ...]) -> Body:
    """Return a part as a body; mass and inertia are sums over signed tetrahedra from the origin.

    A tetrahedron (0, a, b, c) of signed volume V has the second moment
    `V / 20 (s s^T + a a^T + b b^T + c c^T)` with `s = a + b + c`.

    Raises:
        ValueError: the mesh encloses no volume, or is inside out.
    """
    corner = part.mesh.vertices_m[part.mesh.faces]
    volume = np.linalg.det(corner) / 6
    if volume.sum() <= 0:
        raise ValueError(
            f"part {part.name} encloses {1e9 * volume.sum():.3g} mm^3: give a closed mesh whose "
            "faces are counter-clockwise seen from outside"
        )
    total = corner.sum(axis=1)
    center_m = np.einsum("f,fi->i", volume, total) / 4 / volume.sum()
    second = np.einsum("f,fi,fj->ij", volume, total, total)
    second = (second + np.einsum("f,fki,fkj->ij", volume, corner, corner)) / 20
    second -= volume.sum() * np.outer(center_m, center_m)
    return Body(
        hulls=hulls,
        volume_m3=float(volume.sum()),
        mass_kg=float(part.density_kg_m3 * volume.sum()),
        center_m=center_m,
        inertia_kg_m2=part.density_kg_m3 * (np.trace(second) * np.eye(3) - second),
        friction=part.friction,
    )


def motion_m(
    T_world_part: Float[np.ndarray, "t n 4 4"], box_m: Float[np.ndarray, "n 8 3"]
) -> Float[np.ndarray, "t n"]:
    """Return, for each time and part, the largest distance of a point from its last position [m].

    `box_m` has the corners of a box around each part, in the part's frame. The distance is a convex
    function of the point, so no point in the box moves farther than a corner.
    """
    corner_m = box_m @ np.swapaxes(T_world_part[..., :3, :3], -1, -2)
    corner_m += T_world_part[:, :, None, :3, 3]
    away_m = corner_m - corner_m[-1]
    return np.sqrt(np.einsum("tnki,tnki->tnk", away_m, away_m).max(axis=2))


def parts_outside(
    box: Bin, bodies: tuple[Body, ...], T_world_part: Poses, part_index: Kinds
) -> Bool[np.ndarray, " n"]:
    """Return a mask of the parts that are not in the bin.

    A part is in the bin if its centre of mass is above the inner floor's rectangle and its lowest
    point is below the rim. So a part that sticks out of the heap above the rim is inside. A part
    with its centre of mass beyond the wall, or a part on top of an overfull heap, is outside.
    """
    outside = np.zeros(len(part_index), dtype=bool)
    for i, (T, kind) in enumerate(zip(T_world_part, part_index, strict=True)):
        x, y, z = T[:3, :3] @ bodies[kind].center_m + T[:3, 3]
        lowest = min(float((v @ T[2, :3]).min()) for v, _ in bodies[kind].hulls) + T[2, 3]
        over_floor = abs(x) < box.inner_m[0] / 2 and abs(y) < box.inner_m[1] / 2 and z > 0
        outside[i] = not (over_floor and lowest < box.inner_m[2])
    return outside
