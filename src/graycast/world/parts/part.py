"""A part: a mesh, a material, and the properties that physics and datasets need."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from ...base import array_types as arrays
from ...base.public_value import public_value
from ...base.settings import Positive, Share, Vector, check_fields

Color = tuple[Share, Share, Share]  # Red, green and blue are linear.
SMOOTHEST = 0.01
Roughness = Annotated[float, Field(ge=SMOOTHEST, le=1)]
Mottle = Annotated[float, Field(ge=0, le=0.5)]
MOTTLE_PEAK = 1.8  # No place differs from the mean by more than this many times the mottle.
Transparent = Literal["solid", "thin"]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Grain:
    """Direction of the grooves of a metal surface, in the frame of the mesh.

    The grooves run along `axis`, or, if `turned`, in circles about the line of that direction
    through `point_m`, as on a lathe.
    """

    axis: Vector
    turned: bool = False
    point_m: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not np.isfinite(self.axis).all() or not np.any(self.axis):
            raise ValueError(f"the axis of a grain is {self.axis}; it must have a direction")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """A surface, described by a few physical properties.

    `base_color` is linear RGB reflectance; if a `texture` (8-bit sRGB, row 0 on top, mapped by the
    mesh's uv with v up) is given, it replaces the colour. `metallic` 0 is a dielectric: diffuse
    base under a clear rough coat whose normal reflectance is `0.08 * specular` (0.5 is an index of
    1.5; 0 has no coat: a perfect Lambertian). `metallic` 1 is a conductor whose normal reflectance
    is the base colour. `roughness` is perceptual: the GGX alpha is its square. Mirrors (below 0.01)
    are refused, because they would show the lenses, which are not objects. With a `roughness_map`
    (8-bit numbers, mapped like a texture) roughness varies: 255 means `roughness`, 0 means 0, and
    no place is smoother than 0.01. Grooved and transparent materials have no map.

    `anisotropy` makes metal smoother along its `grain` and rougher across it, by Disney's aspect
    `a = sqrt(1 - 0.9 anisotropy)`: GGX has the alpha `roughness^2 a` along and `roughness^2 / a`
    across the grooves. Source: B. Burley, "Physically Based Shading at Disney", SIGGRAPH 2012.

    `projector_reflectance` replaces colour and texture for the measuring camera, whose filter
    passes only the projector's wavelength; None keeps the bands' reflectance.

    A `transparent` material is clear glass or plastic with smooth surfaces: `roughness` is unused,
    `specular` gives its index. A `solid` transmits the share `base_color` over `color_depth_m`
    (Beer's law). A `thin` wall, whose mesh has no thickness, transmits this share at each pass, at
    any angle. `projector_reflectance` is this share at the projector's wavelength.

    `film` is the roughness of a clear film over metal, such as oil or lacquer, with the index from
    `specular`. `base_color` is then the metal's reflectance in the film, less than in air.

    `diffuse` is the share of a metal's light that leaves in all directions by Lambert's law,
    because steep facets of a blasted surface or an oxide layer scatter it several times.

    `mottle` is the relative standard deviation of the reflectance between places, for a blasted,
    cast or rolled surface. The correlation is 1/e at the distance `mottle_length_m`. The mean is
    `base_color`, which must be at most `reflectance_limit`.

    Leaves out: translucency; films over grooves, maps or scattering metal; anisotropic coats;
    spectra finer than three bands and the projector's wavelength.
    """

    base_color: Color = (0.5, 0.5, 0.5)
    texture: arrays.UInt8Array_h_w_3 | None = None
    metallic: Share = 0.0
    roughness: Roughness = 0.5
    specular: Share = 0.5
    projector_reflectance: Share | None = None
    anisotropy: Share = 0.0
    grain: Grain | None = None
    transparent: Transparent | None = None
    color_depth_m: Positive = 0.01
    roughness_map: arrays.UInt8Array_rows_columns | None = None
    film: Roughness | None = None
    diffuse: Share = 0.0
    mottle: Mottle = 0.0
    mottle_length_m: Positive = 0.0003

    def __post_init__(self) -> None:
        check_fields(self)
        if self.anisotropy > 0 and (self.grain is None or self.metallic == 0):
            raise ValueError(
                f"anisotropy is {self.anisotropy}, which needs metal (metallic above 0) and the "
                "direction of its grooves (grain or turned)"
            )
        if self.diffuse > 0 and self.metallic == 0:
            raise ValueError(
                f"diffuse is {self.diffuse}, a share of metal's light, but metallic is 0: set "
                "metallic above 0, or remove diffuse"
            )
        if self.transparent is not None and self.metallic > 0:
            raise ValueError(f"metallic is {self.metallic} of a transparent material: set it to 0")
        if self.transparent is not None and self.texture is not None:
            raise ValueError("a transparent material has a texture: give a base_color instead")
        if self.roughness_map is not None and (self.anisotropy > 0 or self.transparent is not None):
            what = "is transparent" if self.transparent is not None else "has an anisotropy"
            raise ValueError(f"a material with a roughness_map {what}: remove one of the two")
        if self.film is not None:
            self._check_film()
        if self.mottle > 0:
            self._check_mottle()
        for picture in (self.texture, self.roughness_map):
            if picture is not None:
                picture.flags.writeable = False

    def _check_film(self) -> None:
        if self.metallic == 0 or self.specular == 0:
            key = "metallic" if self.metallic == 0 else "specular"
            raise ValueError(f"a material with a film has {key} 0: set it above 0, or remove film")
        keys = {"anisotropy": self.anisotropy > 0, "diffuse": self.diffuse > 0}
        for key, has in (keys | {"roughness_map": self.roughness_map is not None}).items():
            if has:
                raise ValueError(f"a material with a film has {key}: remove one of the two")

    def _check_mottle(self) -> None:
        if self.texture is not None or self.transparent is not None:
            what = "has a texture" if self.texture is not None else "is transparent"
            raise ValueError(f"a material with a mottle {what}: remove one of the two")
        levels = {"base_color": max(self.base_color)}
        levels |= {"projector_reflectance": self.projector_reflectance or 0.0}
        for key, level in levels.items():
            if level > self.reflectance_limit:
                raise ValueError(
                    f"{key} is {level:g} with a mottle of {self.mottle:g}, so bright places would "
                    f"reflect more light than they receive: lower {key} to "
                    f"{math.floor(1000 * self.reflectance_limit) / 1000:g}, or lower the mottle"
                )

    @property
    def reflectance_limit(self) -> float:
        """The largest mean reflectance with which no place reflects more light than it receives."""
        return 1 / (1 + MOTTLE_PEAK * self.mottle)

    def scaled(self, factor: float) -> "Material":
        """Return the material for a mesh `factor` times as large; only a lathe axis changes."""
        if self.grain is None:
            return self
        x, y, z = self.grain.point_m
        grain = replace(self.grain, point_m=(factor * x, factor * y, factor * z))
        return replace(self, grain=grain)

    @property
    def words(self) -> dict[str, Any]:
        """Keys of a configuration that describe the material, without its pictures."""
        words: dict[str, Any] = {"base_color": list(self.base_color)}
        words |= {name: getattr(self, name) for name in ("metallic", "roughness", "specular")}
        if self.projector_reflectance is not None:
            words["projector_reflectance"] = self.projector_reflectance
        if self.transparent is not None:
            words["transparent"] = self.transparent
            if self.transparent == "solid":
                words["color_depth_m"] = self.color_depth_m
        if self.film is not None:
            words["film"] = self.film
        if self.diffuse > 0:
            words["diffuse"] = self.diffuse
        if self.mottle > 0:
            words |= {"mottle": self.mottle, "mottle_length_m": self.mottle_length_m}
        if (grain := self.grooves) is not None:
            words["anisotropy"] = self.anisotropy
            words["turned" if grain.turned else "grain"] = list(grain.axis)
            if grain.turned:
                words["turned_about_m"] = list(grain.point_m)
        return words

    @property
    def grooves(self) -> Grain | None:
        """The grain if the metal is rougher across it than along it, else None."""
        return self.grain if self.anisotropy > 0 else None

    @property
    def alphas(self) -> tuple[float, float]:
        """Alpha of GGX along the grain and across it."""
        aspect = math.sqrt(1 - 0.9 * self.anisotropy)
        return self.roughness**2 * aspect, self.roughness**2 / aspect

    @property
    def local_roughness(self) -> arrays.FloatArray_rows_columns:
        """The roughness at each texel of the map; a single value without a map."""
        share = np.ones((1, 1)) if self.roughness_map is None else self.roughness_map / 255
        return np.maximum(self.roughness * share, SMOOTHEST)

    @property
    def smoothest(self) -> float:
        """The lowest roughness anywhere on the surface."""
        return float(self.local_roughness.min())

    @property
    def ior(self) -> float:
        """Index of refraction of the coat, by Fresnel's reflectance at normal incidence."""
        root = math.sqrt(0.08 * self.specular)
        return (1 + root) / (1 - root)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Mesh:
    """A triangle mesh [m] with faces counter-clockwise seen from outside.

    uv and shading normals belong to face corners, so seams and sharp edges need no doubled
    vertices and a watertight mesh stays watertight. Without normals a mesh is shaded flat.
    """

    vertices_m: arrays.FloatArray_v_3
    faces: arrays.IntArray_f_3
    corner_uv: arrays.FloatArray_f_3_2 | None = None
    corner_normals: arrays.FloatArray_f_3_3 | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for array in (self.vertices_m, self.faces, self.corner_uv, self.corner_normals):
            if array is not None:
                array.flags.writeable = False
        if len(self.faces) == 0:
            raise ValueError("the mesh has no faces; give a mesh with triangles")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices_m):
            span = f"[{self.faces.min()}, {self.faces.max()}]"
            raise ValueError(
                f"face indices span {span}, the mesh has {len(self.vertices_m)} vertices"
            )
        if not np.isfinite(self.vertices_m).all():
            raise ValueError("the mesh has vertices that are not finite")

    @property
    def bounds_m(self) -> arrays.FloatArray_2_3:
        """Lowest and highest corner of the axis-aligned box."""
        return np.stack([self.vertices_m.min(axis=0), self.vertices_m.max(axis=0)])

    @property
    def extent_m(self) -> arrays.FloatArray_3:
        return np.ptp(self.vertices_m, axis=0)

    @property
    def face_area_m2(self) -> arrays.FloatArray_f:
        return np.linalg.norm(self._face_cross_m2, axis=1) / 2

    @property
    def face_normal(self) -> arrays.FloatArray_f_3:
        """Outward normals of length 1; zero for a face without area."""
        cross = self._face_cross_m2
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return cross / np.where(length > 0, length, 1.0)

    @property
    def _face_cross_m2(self) -> Float[np.ndarray, "f 3"]:
        corner = self.vertices_m[self.faces]
        return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


_END = np.cos(np.radians(20))  # A face whose normal is nearer to the grain has other grooves.


def corner_grain(mesh: Mesh, grain: Grain) -> Float[np.ndarray, "f 3 3"]:
    """Return the direction of grooves at each face corner, neither normalised nor tangential.

    On a turned part it is `axis x (corner - point)`, which is linear, so interpolation within a
    face is exact. Faces nearly across the grain have a different direction: the axis x, y or z
    farthest from the grain on ends of a brushed part, and the axis on radial faces of a turned
    part.
    """
    axis = np.array(grain.axis) / np.linalg.norm(grain.axis)
    corner_m = mesh.vertices_m[mesh.faces]
    if grain.turned:
        along, other = np.cross(axis, corner_m - grain.point_m), axis
    else:
        along, other = np.broadcast_to(axis, corner_m.shape), np.eye(3)[np.argmin(np.abs(axis))]
    middle = along.mean(axis=1)
    out = np.abs(np.einsum("fi,fi->f", middle, mesh.face_normal))
    is_end = out > _END * np.linalg.norm(middle, axis=1)
    return np.where(is_end[:, None, None], other, along)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Symmetry:
    """The rigid motions that leave a part looking the same, in its own frame.

    `discrete`: transforms other than the identity. `continuous`: (axis, point on the axis [m]) of
    rotational symmetry.
    """

    discrete: tuple[arrays.FloatArray_4_4, ...] = ()
    continuous: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One kind of part. `source` names its origin, for datasets and error messages.

    A part that is not `labelled` is in the heap and hides other parts, but is not annotated.
    """

    name: str
    mesh: Mesh
    material: Material
    density_kg_m3: float
    friction: float
    symmetry: Symmetry = field(default_factory=Symmetry)
    source: str = "built in"
    labelled: bool = True

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.density_kg_m3 > 0:
            raise ValueError(
                f"part {self.name}: density_kg_m3 is {self.density_kg_m3}; it must be greater "
                "than 0"
            )
        if not self.friction >= 0:
            raise ValueError(
                f"part {self.name}: friction is {self.friction}; it must be at least 0"
            )

    def scaled(self, factor: float) -> "Part":
        """Return the part `factor` times as large, with the same material."""
        vertices_m = self.mesh.vertices_m * factor
        discrete = tuple(np.array(motion) for motion in self.symmetry.discrete)
        for motion in discrete:
            motion[:3, 3] *= factor
        continuous = tuple(
            (axis, (factor * x, factor * y, factor * z))
            for axis, (x, y, z) in self.symmetry.continuous
        )
        return replace(
            self,
            mesh=replace(self.mesh, vertices_m=vertices_m),
            material=self.material.scaled(factor),
            symmetry=Symmetry(discrete=discrete, continuous=continuous),
        )


def glass_notes(parts: Iterable[Part]) -> tuple[str, ...]:
    """Return a note for each part of solid glass: renders have too little light behind it."""
    return tuple(
        f"the part {part.name} is solid glass: the projector's light does not reach what the "
        "camera sees through it, so there is no depth behind; docs/explanation/limits.md has the "
        "figure, and `transparent: thin` suits a thin wall"
        for part in parts
        if part.material.transparent == "solid"
    )
