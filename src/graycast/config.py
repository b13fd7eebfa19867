"""What a user writes in YAML, checked, and the values that it stands for.

Every key that is not known stops the run and is named with its file and the nearest known key.
Paths in a configuration are relative to its file.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import UInt8
from PIL import Image, UnidentifiedImageError
from pydantic import (
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from .decode import triangulation_axis
from .drop import DropLimits
from .errors import ConfigError
from .frames import is_rigid
from .parts import BUILTIN, Material, Part, Symmetry, builtin_part, load_part
from .parts.wood import wood_texture
from .render import Quality
from .rig_file import ScannerSections, with_sections
from .rig_file import resolve_scanner as resolve_rig_file
from .scanner import Scanner
from .scene import Bin, Environment, Lamp
from .settings import Settings, read_settings

Vector = tuple[float, float, float]
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]
Level = Annotated[float, Field(ge=0)]


class MaterialSection(Settings):
    """A surface in a few physical words."""

    base_color: tuple[Share, Share, Share] = Field(
        (0.5, 0.5, 0.5), description="linear RGB reflectance, each 0 to 1"
    )
    texture: Path | None = Field(None, description="picture file that replaces base_color (sRGB)")
    metallic: Share = Field(0.0, description="0 plastic, paint, wood, card; 1 bare metal")
    roughness: float = Field(0.5, ge=0.05, le=1, description="0.05 polished to 1 matt")
    specular: Share = Field(0.5, description="0 Lambertian, 0.5 clear coat of index 1.5")
    projector_reflectance: Share | None = Field(
        None, description="at the projector's wavelength; left out: base_color in its bands"
    )


class ContinuousSymmetry(Settings):
    axis: Vector
    point_m: Vector = (0.0, 0.0, 0.0)

    @field_validator("axis")
    @classmethod
    def _direction(cls, axis: Vector) -> Vector:
        if not any(axis):
            raise ValueError("an axis has a direction, such as [0, 0, 1]")
        x, y, z = np.array(axis) / np.linalg.norm(axis)  # datasets hold unit vectors
        return float(x), float(y), float(z)


class SymmetrySection(Settings):
    """Rigid motions that leave the part looking the same, in its own frame."""

    discrete: tuple[tuple[float, ...], ...] = Field(
        (), description="4x4 transforms, row by row (16 numbers, metres)"
    )
    continuous: tuple[ContinuousSymmetry, ...] = ()

    @model_validator(mode="after")
    def _sixteen(self) -> "SymmetrySection":
        for matrix in self.discrete:
            if len(matrix) != 16:
                raise ValueError(f"a discrete symmetry has {len(matrix)} numbers; give 16")
            if not is_rigid(np.reshape(matrix, (4, 4))):
                raise ValueError("a discrete symmetry is not a rotation and a translation")
        return self


class PartSection(Settings):
    """A kind of part: one of the built-in ones, or a mesh file of your own."""

    builtin: str | None = Field(None, description=f"one of {', '.join(BUILTIN)}")
    mesh: Path | None = Field(None, description="OBJ, PLY, STL or GLB file")
    unit: Literal["m", "cm", "mm", "inch"] | None = Field(
        None, description="the mesh file's unit; asked for unless metres are plausible"
    )
    name: str | None = None
    material: MaterialSection | None = Field(None, description="instead of the part's own")
    density_kg_m3: Positive | None = Field(None, description="a solid mesh: 7800 is steel")
    friction: float | None = Field(None, ge=0)
    symmetry: SymmetrySection | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "PartSection":
        if (self.builtin is None) == (self.mesh is None):
            raise ValueError("give either builtin or mesh")
        if self.builtin is not None and (self.unit or self.name or self.symmetry):
            raise ValueError("unit, name and symmetry belong to a mesh, not to a built-in part")
        return self


class BinSection(Settings):
    """The box; all sizes are of its inside."""

    inner_m: tuple[Positive, Positive, Positive] = (0.40, 0.30, 0.15)
    wall_m: Positive = 0.012
    material: MaterialSection | None = Field(None, description="left out: a wood of our own")
    friction: float = Field(0.5, ge=0)


class EnvironmentSection(Settings):
    """Light from all around."""

    radiance: tuple[Level, Level, Level] = Field(
        (0.2, 0.2, 0.2), description="W/(sr m^2) per band; scales the map where there is one"
    )
    map: Path | None = Field(None, description="latitude-longitude EXR or HDR picture")


class LampSection(Settings):
    """A square lamp above the cell."""

    center_m: Vector
    target_m: Vector = (0.0, 0.0, 0.0)
    size_m: Positive = 0.3
    radiance: tuple[Level, Level, Level] = (15.0, 15.0, 15.0)


class LightSection(Settings):
    environment: EnvironmentSection = EnvironmentSection()
    lamps: tuple[LampSection, ...] = (LampSection(center_m=(0.7, -0.5, 1.6)),)


class ViewSection(Settings):
    """Where the rig hangs. At azimuth 0 its baseline runs along the world's x."""

    distance_m: Positive | None = Field(
        None, description="middle of the baseline to the target; else where the axes cross"
    )
    tilt_deg: float = Field(0.0, ge=0, le=80)
    azimuth_deg: float = 0.0
    target_m: Vector | None = Field(None, description="else a third of the bin's height up")


class CyclesSection(Settings):
    """What only Blender Cycles has."""

    denoise: Literal["none", "oidn", "optix"] = Field(
        "oidn", description="of every picture, patterns too, as the paper does; optix needs a GPU"
    )
    patterns_per_render: Literal[1, 3] = Field(
        1, description="3: a pattern each in R, G and B, where light is of one wavelength"
    )


class RenderSection(Settings):
    backend: Literal["mitsuba", "cycles"] = Field(
        "mitsuba", description="all patterns in one pass, or each by itself in Blender"
    )
    samples: int = Field(16, ge=1, le=65536, description="paths per pixel")
    depth: int = Field(4, ge=1, le=64, description="vertices per path; 1 is direct light alone")
    denoise: bool = Field(True, description="of the colour picture alone")
    cycles: CyclesSection = CyclesSection()


class DropSection(Settings):
    penetration_m: float = Field(
        0.5e-3, gt=0, le=0.1, description="deepest overlap that is accepted"
    )
    attempts: int = Field(5, ge=1)


class Config(ScannerSections):
    """One dataset: its parts, bin, rig, light and how much of it.

    The sections code, exposure, sensor, decode and filters say what differs from the rig's own.
    """

    parts: tuple[PartSection, ...] = Field(min_length=1)
    mix: bool = Field(False, description="all classes in each scene, not one class per scene")
    count: int | tuple[int, int] = Field(
        30, description="parts per scene, or the lowest and highest number"
    )
    scenes: int = Field(3, ge=1, description="how many; --scenes goes before")
    seed: int = Field(0, ge=0, description="of everything random; --seed goes before")
    bin: BinSection = BinSection()
    rig: str = Field("paper", description="a preset's name or a rig file")
    resolution: Literal["low", "full"] = Field("low", description="of a preset's camera")
    view: ViewSection = ViewSection()
    light: LightSection = LightSection()
    render: RenderSection = RenderSection()
    drop: DropSection = DropSection()

    @field_validator("count", mode="wrap")
    @classmethod
    def _countable(cls, value: Any, check: Callable[[Any], Any]) -> int | tuple[int, int]:
        try:
            count = check(value)
        except ValidationError:
            raise ValueError("give a number of parts, or [lowest, highest]") from None
        low, high = (count, count) if isinstance(count, int) else count
        if not 1 <= low <= high <= 255:
            raise ValueError("give 1 to 255, or [lowest, highest] of these")
        return count

    @property
    def count_range(self) -> tuple[int, int]:
        return (self.count, self.count) if isinstance(self.count, int) else self.count


def config_schema() -> dict[str, Any]:
    """The JSON Schema of a configuration, for editors."""
    return Config.model_json_schema()


def load_config(path: Path) -> Config:
    """Read and check a configuration.

    Raises:
        ConfigError: the file is missing, is not YAML, or has an unknown or wrong key.
    """
    return read_settings(path, Config)


# --- from words to values ----------------------------------------------------------------------


def resolve_parts(config: Config, folder: Path) -> tuple[tuple[Part, ...], tuple[str, ...]]:
    """The parts of a configuration, and what was noticed about their meshes.

    Raises:
        ConfigError: an unknown built-in part, or a texture that cannot be read.
        MeshError: a mesh that cannot be a part.
    """
    parts, notes = [], []
    for section in config.parts:
        part, found = _part(section, folder)
        if part.name in {other.name for other in parts}:
            raise ConfigError(f"two parts are called {part.name}: give one another name")
        parts.append(part)
        notes.extend(f"{part.name}: {note}" for note in found)
    return tuple(parts), tuple(notes)


def _part(section: PartSection, folder: Path) -> tuple[Part, tuple[str, ...]]:
    material = None if section.material is None else resolve_material(section.material, folder)
    if section.builtin is not None:
        if section.builtin not in BUILTIN:
            raise ConfigError(f"no built-in part {section.builtin!r}: choose {', '.join(BUILTIN)}")
        own = builtin_part(section.builtin)
        return replace(
            own,
            material=material or own.material,
            density_kg_m3=section.density_kg_m3 or own.density_kg_m3,
            friction=own.friction if section.friction is None else section.friction,
        ), ()
    symmetry = section.symmetry or SymmetrySection()
    return load_part(
        folder / section.mesh,
        name=section.name,
        unit=section.unit,
        material=material,
        density_kg_m3=section.density_kg_m3 or 1000.0,
        friction=0.4 if section.friction is None else section.friction,
        symmetry=Symmetry(
            discrete=tuple(np.reshape(matrix, (4, 4)) for matrix in symmetry.discrete),
            continuous=tuple((s.axis, s.point_m) for s in symmetry.continuous),
        ),
    )


def resolve_material(section: MaterialSection, folder: Path) -> Material:
    """A material, its texture read.

    Raises:
        ConfigError: the texture cannot be read.
    """
    texture = None if section.texture is None else _read_texture(folder / section.texture)
    return Material(
        base_color=section.base_color,
        texture=texture,
        metallic=section.metallic,
        roughness=section.roughness,
        specular=section.specular,
        projector_reflectance=section.projector_reflectance,
    )


def _read_texture(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    try:
        with Image.open(path) as image:
            return np.array(image.convert("RGB"))
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise ConfigError(f"texture {path}: {error}; give a PNG or JPEG picture") from error


def resolve_bin(section: BinSection, folder: Path) -> Bin:
    if section.material is None:
        material = Material(texture=wood_texture(), roughness=0.6)
    else:
        material = resolve_material(section.material, folder)
    return Bin(
        inner_m=section.inner_m, wall_m=section.wall_m, material=material, friction=section.friction
    )


def resolve_environment(section: EnvironmentSection, folder: Path) -> Environment:
    if section.map is None:
        return Environment(radiance=section.radiance)
    path = folder / section.map
    if not path.is_file():
        raise ConfigError(f"light.environment.map: no file {path}")
    return Environment(radiance=section.radiance, map_file=path)


def resolve_lamps(section: LightSection) -> tuple[Lamp, ...]:
    return tuple(Lamp(**lamp.model_dump()) for lamp in section.lamps)


def resolve_scanner(config: Config, folder: Path) -> Scanner:
    """The rig that a configuration names, with what its sections change.

    Raises:
        ConfigError: no such rig, or a code without the axis that its baseline runs along.
    """
    named = resolve_rig_file(config.rig, folder=folder, resolution=config.resolution)
    scanner = with_sections(named, config)
    axis = triangulation_axis(scanner.rig)
    if axis not in scanner.code.axes:
        axes = ", ".join(scanner.code.axes)
        raise ConfigError(f"code.axes is {axes}: rig {scanner.rig.name} needs {axis} for depth")
    return scanner


def resolve_quality(config: Config) -> Quality:
    render = config.render
    return Quality(
        samples=render.samples,
        depth=render.depth,
        denoise=render.cycles.denoise if render.backend == "cycles" else "none",
    )


def resolve_limits(config: Config) -> DropLimits:
    return DropLimits(**config.drop.model_dump())


def file_digests(config: Config, folder: Path) -> dict[str, str]:
    """SHA-256 of every file that a configuration names, so that a changed file is noticed."""
    named = [section.mesh for section in config.parts]
    named += [section.material and section.material.texture for section in config.parts]
    named += [config.bin.material and config.bin.material.texture, config.light.environment.map]
    digests = {}
    for path in named:
        if path is not None:
            digests[str(path)] = hashlib.sha256((folder / path).read_bytes()).hexdigest()
    return digests
