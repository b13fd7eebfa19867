"""The world before physics and light: parts, bin, surfaces, lights and rig.

World frame: origin in the middle of the bin's inner floor, z up. The bin is on a table that looks
endless; the table's top is at `z = -bin.floor_m`.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool
from pydantic import Field

from ..base import array_types as arrays
from ..base.frames import is_rigid
from ..base.public_value import public_value
from ..base.settings import Level, Positive, Vector, check_fields
from ..rig.pair import Rig
from .parts import Material, Mesh, Part

BandRadiance = tuple[Level, Level, Level]  # Red, green and blue are in [W sr^-1 m^-2].
Inner = Annotated[float, Field(ge=0.01, le=5)]
Wall = Annotated[float, Field(ge=0.0005, le=0.2)]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """A bin: an open box or a mesh. The material's texture repeats every `texture_size_m`.

    `floor` is the material of the inner floor; None: `material`. A `mesh` is in the world frame,
    `inner_m` is then its approximate inner size, and `wall_m` is unused. With `own_texture`, the
    mesh's uv place the material's texture.
    """

    inner_m: tuple[Inner, Inner, Inner]
    wall_m: Wall = 0.012
    mesh: Mesh | None = None
    own_texture: bool = False
    material: Material = field(default_factory=Material)
    floor: Material | None = None
    texture_size_m: float = 0.5
    friction: Level = 0.5

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def bounds_m(self) -> arrays.FloatArray_2_3:
        """Lowest and highest corner of the whole bin."""
        if self.mesh is not None:
            return self.mesh.bounds_m
        x, y = (size / 2 + self.wall_m for size in self.inner_m[:2])
        return np.array([[-x, -y, -self.wall_m], [x, y, self.inner_m[2]]])

    @property
    def floor_m(self) -> float:
        """Height of the inner floor above the table."""
        return -float(self.bounds_m[0, 2])


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Quad:
    """A flat rectangle: centre and half edges in world coordinates [m]; lit on one side.

    Its front faces along `cross(half_u_m, half_v_m)`. A texture starts at the corner
    `-half_u_m - half_v_m` and repeats every `texture_size_m`; None spreads it over the whole quad.
    """

    center_m: tuple[float, float, float]
    half_u_m: tuple[float, float, float]
    half_v_m: tuple[float, float, float]
    material: Material
    texture_size_m: float | None = None

    def __post_init__(self) -> None:
        u, v = np.array(self.half_u_m), np.array(self.half_v_m)
        if not (u.any() and v.any()) or abs(u @ v) > 1e-6 * np.linalg.norm(u) * np.linalg.norm(v):
            raise ValueError(
                f"the two half edges of a quad are {u} and {v}; they must be perpendicular and "
                "not 0"
            )
        if self.material.transparent == "solid":
            raise ValueError(
                "a quad has no inside: its material can be transparent thin, not solid"
            )

    @property
    def texture_repeats(self) -> tuple[float, float]:
        """Number of times that a texture fits along each edge."""
        if self.texture_size_m is None:
            return 1.0, 1.0
        u, v = (2 * float(np.linalg.norm(half)) for half in (self.half_u_m, self.half_v_m))
        return u / self.texture_size_m, v / self.texture_size_m


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    center_m: tuple[float, float, float]
    radius_m: float
    material: Material

    def __post_init__(self) -> None:
        if self.material.anisotropy > 0:
            words = f"a sphere's material has the anisotropy {self.material.anisotropy}"
            raise ValueError(f"{words}; a sphere has no grain: set it to 0, or give a part")
        if self.material.mottle > 0:
            raise ValueError(
                f"a sphere's material has the mottle {self.material.mottle}; only meshes can have "
                "it: set it to 0, or give a part"
            )


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Environment:
    """Light from all around: constant `radiance` [W sr^-1 m^-2 per band], or a map multiplied by
    it.

    A map (EXR, HDR) is latitude-longitude with its top row at the world's zenith and its left
    border towards the world's +y; `rotation_rad` turns it about the world's z by the right-hand
    rule. A `levelled` map is first divided by its own mean over all directions and bands, so that
    `radiance` is the mean, whatever unit the file has.
    """

    radiance: BandRadiance = (0.2, 0.2, 0.2)
    map_file: Path | None = None
    rotation_rad: float = 0.0
    levelled: bool = False

    def __post_init__(self) -> None:
        check_fields(self)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """A square area lamp that shines in all directions from its front; its back is black."""

    center_m: Annotated[
        Vector, Field(description="The position of the lamp's middle in the world, in metres.")
    ]
    target_m: Annotated[
        Vector, Field(description="The point at which the lamp looks, in metres.")
    ] = (0.0, 0.0, 0.0)
    size_m: Annotated[Positive, Field(description="The edge length of the lamp in metres.")] = 0.3
    radiance: Annotated[
        BandRadiance, Field(description="The radiance of each band, in W/(sr m^2).")
    ] = (15.0, 15.0, 15.0)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.center_m == self.target_m:
            raise ValueError(
                f"the lamp at {self.center_m} has its target at its own position: move target_m"
            )


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that light meets, except the poses of the dropped parts.

    `parts` are the kinds of parts, unlabelled kinds last; a `Layout` has the poses of their
    instances. `surfaces` are analytic shapes for measurement. Without a bin, there is no table. The
    table's texture is repeated every `table_texture_m`; None spreads it over the whole table.
    """

    rig: Rig
    T_world_cam: arrays.FloatArray_4_4
    parts: tuple[Part, ...] = ()
    bin: Bin | None = None
    table: Material = field(default_factory=lambda: Material(base_color=(0.35, 0.35, 0.36)))
    table_texture_m: float | None = None
    surfaces: tuple[Quad | Sphere, ...] = ()
    environment: Environment = field(default_factory=Environment)
    lamps: tuple[Lamp, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        self.T_world_cam.flags.writeable = False
        if not is_rigid(self.T_world_cam):
            raise ValueError("T_world_cam is not a rotation and a translation")
        opaque = () if self.bin is None else (self.table, self.bin.material, self.bin.floor)
        if any(material and material.transparent for material in opaque):
            raise ValueError("a bin and a table cannot be transparent: parts alone can be")
        labelled = [part.labelled for part in self.parts]
        if labelled != sorted(labelled, reverse=True):  # A label is an index into the parts.
            raise ValueError(f"labelled parts are {labelled}: parts without a label must come last")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The result of a drop: the parts' poses, and the figures by which a layout is accepted.

    `part_index[i]` indexes `Scene.parts`; instance i has the pose `T_world_part[i]`. `Layout` does
    not check the figures. `last_motion_m` is how far any point of a part moved within the last 0.6
    s, or 0.2 s if these showed rest. Penetration is measured between collision hulls, which may be
    half a millimetre inside a curved surface.
    """

    T_world_part: arrays.FloatArray_n_4_4
    part_index: arrays.IntArray_n
    at_rest: bool = True
    last_motion_m: float = 0.0
    deepest_penetration_m: float = 0.0
    outside: int = 0
    simulated_s: float = 0.0
    attempt: int = 0

    def __post_init__(self) -> None:
        self.T_world_part.flags.writeable = False
        self.part_index.flags.writeable = False


def bin_of(scene: Scene) -> Bin:
    """Return the scene's bin, or raise an error if there is no bin.

    Raises:
        ValueError: the scene has no bin.
    """
    if scene.bin is None:
        raise ValueError("this scene has no bin, which this function needs: give Scene(bin=...)")
    return scene.bin


TABLE_HALF_M = 4.0  # The table's edge is far enough away that the table looks endless.

EMPTY_LAYOUT = Layout(T_world_part=np.zeros((0, 4, 4)), part_index=np.zeros(0, dtype=np.int64))


def table_quad(scene: Scene) -> Quad | None:
    """Return the table under the bin; None without a bin."""
    if scene.bin is None:
        return None
    return Quad(
        center_m=(0.0, 0.0, -scene.bin.floor_m),
        half_u_m=(TABLE_HALF_M, 0.0, 0.0),
        half_v_m=(0.0, TABLE_HALF_M, 0.0),
        material=scene.table,
        texture_size_m=scene.table_texture_m,
    )


def quad_mesh(quad: Quad) -> Mesh:
    """Return a quad as two triangles; its texture's row 0 is along the edge at `+half_v_m`."""
    center, u, v = (np.array(value) for value in (quad.center_m, quad.half_u_m, quad.half_v_m))
    corners = np.array([center - u - v, center + u - v, center + u + v, center - u + v])
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * quad.texture_repeats
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(vertices_m=corners, faces=faces, corner_uv=uv[faces])


def lamp_quad(lamp: Lamp) -> Quad:
    """Return a lamp as a black quad whose front faces the target, without its emission."""
    center, target = np.array(lamp.center_m), np.array(lamp.target_m)
    direction = (target - center) / np.linalg.norm(target - center)
    aside = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    aside *= 0.5 * lamp.size_m / np.linalg.norm(aside)
    return Quad(
        center_m=lamp.center_m,
        half_u_m=tuple(aside.tolist()),
        half_v_m=tuple(np.cross(direction, aside).tolist()),
        material=Material(base_color=(0.0, 0.0, 0.0), specular=0.0),
    )


def bin_mesh(box: Bin) -> Mesh:
    """Return the bin as a watertight mesh, textured in metres along each face's own two axes."""
    mesh = _box_mesh(box) if box.mesh is None else box.mesh
    if box.own_texture:
        return mesh
    corner = mesh.vertices_m[mesh.faces]
    axis = np.abs(mesh.face_normal).argmax(axis=1)
    # Wood grain (u) runs along the longer horizontal direction of each face.
    u = np.where((axis == 0)[:, None], corner[..., 1], corner[..., 0])
    v = np.where((axis == 2)[:, None], corner[..., 1], corner[..., 2])
    return replace(mesh, corner_uv=np.stack([u, v], axis=-1) / box.texture_size_m)


def _box_mesh(box: Bin) -> Mesh:
    inner_x, inner_y, height = box.inner_m
    outer = np.array([inner_x / 2 + box.wall_m, inner_y / 2 + box.wall_m])
    inner = np.array([inner_x / 2, inner_y / 2])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

    def ring(half: np.ndarray, z: float) -> np.ndarray:
        return np.column_stack([corners * half, np.full(4, z)])

    # Vertex rings: 0-3 outer bottom, 4-7 outer top, 8-11 inner top, 12-15 inner floor.
    vertices = np.vstack(
        [ring(outer, -box.wall_m), ring(outer, height), ring(inner, height), ring(inner, 0.0)]
    )
    quads = [[3, 2, 1, 0], [12, 13, 14, 15]]
    for i in range(4):
        j = (i + 1) % 4
        quads += [
            [i, j, j + 4, i + 4],
            [i + 4, j + 4, j + 8, i + 8],
            [i + 8, j + 8, j + 12, i + 12],
        ]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return Mesh(vertices_m=vertices, faces=faces)


def inner_floor(box: Bin, mesh: Mesh) -> Bool[np.ndarray, " f"]:
    """Return a mask of the faces of the bin's inner floor, which face up at the floor's height."""
    corner = mesh.vertices_m[mesh.faces]
    looks_up = mesh.face_normal[:, 2] > _UPRIGHT
    low = np.abs(corner[..., 2]).max(axis=1) < max(1e-3, _LOW * box.inner_m[2])
    within = (np.abs(corner[..., :2].mean(axis=1)) < np.array(box.inner_m[:2]) / 2).all(axis=1)
    return looks_up & low & within


_UPRIGHT, _LOW = (
    0.9,
    0.03,
)  # least cosine between a floor's normal and z; greatest deviation as a share of the depth


def bin_surfaces(box: Bin) -> tuple[tuple[str, Mesh, Material], ...]:
    """Return name, mesh and material of each surface of the bin.

    The bin is one surface, or two (walls and inner floor) if the floor has its own material.
    """
    whole = bin_mesh(box)
    if box.floor is None:
        return (("bin", whole, box.material),)
    floor = inner_floor(box, whole)
    return (
        ("bin", _faces_of(whole, ~floor), box.material),
        ("floor", _faces_of(whole, floor), box.floor),
    )


def _faces_of(mesh: Mesh, subset: Bool[np.ndarray, " f"]) -> Mesh:
    """Return a mesh with some of the faces; unused vertices stay, because they do no harm."""
    return Mesh(
        vertices_m=mesh.vertices_m,
        faces=mesh.faces[subset],
        corner_uv=None if mesh.corner_uv is None else mesh.corner_uv[subset],
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals[subset],
    )
