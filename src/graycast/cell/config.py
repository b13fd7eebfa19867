"""The configuration that a user writes in YAML: it is checked and resolved to values.

An unknown key stops the run; the error names it, its file and the most similar known key. Paths in
a configuration are relative to its file.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from ..base.errors import ConfigError
from ..base.file_limits import refuse_large_picture
from ..base.progress import UNWATCHED, ProgressMeter
from ..base.settings import Level, Settings, read_settings
from ..camera.decode import triangulation_axis
from ..camera.rig_file import ScannerSections, named_scanner, own_device, with_sections
from ..camera.scanner import Scanner
from ..rendering import Quality
from ..rendering.radiance import PathDepth, Samples
from ..rig.former_names import RigName
from ..world.bins import Up, load_bin
from ..world.drop import DropLimits
from ..world.parts import Material, Part
from ..world.parts.material_section import MaterialWords, resolve_material
from ..world.parts.part_sections import PartSection, Unit, resolve_part
from ..world.parts.wood import wood_texture
from ..world.scene import BandRadiance, Bin, Environment, Inner, Lamp, Wall
from .domain import DomainSection
from .motion import OptionalMotion
from .views import DomeSection, JitterSection, ScannerEntry, Views, ViewSection


class BinSection(Settings):
    """A bin: a box of stated inner sizes, or a mesh file."""

    inner_m: tuple[Inner, Inner, Inner] = Field(
        default=(0.40, 0.30, 0.15),
        description="The inner length, width and height of the box, in metres.",
    )
    wall_m: Wall = Field(default=0.012, description="The thickness of the walls in metres.")
    mesh: Path | None = Field(
        default=None,
        description="An OBJ, PLY, STL or GLB file of the bin, which replaces inner_m and wall_m.",
    )
    unit: Unit | None = Field(
        default=None,
        description="The unit of the mesh file. It must be stated if the sizes are not "
        "plausible in metres.",
    )
    up_axis: Up = Field(
        default="z",
        description="The axis of the mesh file that points out of the bin's opening.",
    )
    material: MaterialWords | None = Field(
        default=None,
        description="The material of the bin. Without this key, a box is of wood, and a mesh "
        "has the material of its file.",
    )
    floor: MaterialWords | None = Field(
        default=None,
        description="The material of the inner floor. Without this key, it is the material "
        "of the walls.",
    )
    friction: Level = Field(
        default=0.5, description="The coefficient of friction between the bin and the parts."
    )

    @model_validator(mode="after")
    def _one_shape(self) -> "BinSection":
        # Values are compared with defaults, because a configuration from a manifest sets every key.
        of_other = ("unit", "up_axis") if self.mesh is None else ("inner_m", "wall_m")
        fields = BinSection.model_fields
        names = [name for name in of_other if getattr(self, name) != fields[name].default]
        if names and self.mesh is None:
            raise ValueError(f"{' and '.join(names)} of a bin belong to a mesh: name its file")
        if names:
            raise ValueError(f"a mesh has its own size: remove {' and '.join(names)}, or mesh")
        return self


class EnvironmentSection(Settings):
    """Light from all around."""

    radiance: BandRadiance = Field(
        default=(0.2, 0.2, 0.2),
        description="The radiance of each band, in W/(sr m^2). It scales the map.",
    )
    map: Path | None = Field(default=None, description="EXR or HDR file by latitude and longitude.")


class LightSection(Settings):
    """The light of the cell: its environment and its lamps."""

    environment: EnvironmentSection = EnvironmentSection()
    lamps: tuple[Lamp, ...] = Field(
        default=(Lamp(center_m=(0.7, -0.5, 1.6)),), description="The lamps of the cell."
    )


class CyclesSection(Settings):
    """Settings for Blender Cycles only."""

    denoise: Literal["none", "oidn", "optix"] = Field(
        default="oidn", description="The denoiser of every picture. optix needs a GPU."
    )
    patterns_per_render: Literal[1, 3] = Field(
        default=1,
        description="The number of patterns in a render. With 3, the red, green and blue "
        "channels hold one pattern each.",
    )


class RenderSection(Settings):
    """Settings of the rendering."""

    backend: Literal["mitsuba", "cycles"] = Field(
        default="mitsuba",
        description="The renderer. mitsuba renders all patterns in one pass; "
        "cycles renders them one after the other.",
    )
    samples: Samples = 16
    depth: PathDepth = 4
    denoise: bool = Field(
        default=True,
        description="Whether the colour picture is denoised. The "
        "pictures of patterns are not affected.",
    )
    cycles: CyclesSection = CyclesSection()


class StoreSection(Settings):
    """Files of a scene in addition to pictures, depth and labels."""

    frames: bool = Field(
        default=False, description="Keep every picture as the sensor stored it, for rig decode."
    )
    columns: bool = Field(
        default=False, description="Keep decoded projector columns and rows with their deviations."
    )
    depth_step_mm: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        exclude=True,  # A dataset states this value as its depth_scale.
        description="One step of the depth pictures in millimetres. Without this key, 16 "
        "bits span the range.",
    )


class Config(ScannerSections):
    """One dataset: its parts, bin, rig, light and number of scenes.

    The sections code, exposure, sensor, decode and filters replace settings of the rig.
    """

    parts: tuple[PartSection, ...] = Field(
        min_length=1, description="The kinds of parts that fall into the bin."
    )
    mix: bool = Field(
        default=False,
        description="Whether each scene has parts of all kinds. Otherwise each scene has one "
        "kind, and the kinds alternate.",
    )
    count: int | tuple[int, int] = Field(
        default=30,
        description="The number of parts in a scene, from 0 to 255, or its lowest and its highest "
        "value. A scene without parts shows the empty bin.",
    )
    fill: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="The share of the bin that the parts of a scene fill as a loose heap, from 0 "
        "to 1. It replaces count.",
    )
    scenes: int = Field(
        default=3, ge=1, description="The number of scenes. The option --scenes replaces it."
    )
    seed: int = Field(
        default=0, ge=0, description="The seed of all random numbers; --seed replaces it."
    )
    bin: BinSection = BinSection()
    table: MaterialWords | None = Field(
        default=None,
        description="The material of the table on which the bin stands. Without this key, it "
        "is matt grey.",
    )
    rig: RigName = Field(default="paper", description="The name of a preset, or a rig file.")
    resolution: Literal["small", "low", "full"] = Field(
        default="low",
        description="The size of a preset: 516 x 386, 1032 x 772 or 2064 x 1544 pixels.",
    )
    view: ViewSection = ViewSection()
    views: Views | None = Field(
        default=None,
        description="Several images of each scene: a list of places, or dome, path or jitter.",
    )
    scanners: tuple[ScannerEntry, ...] | None = Field(
        default=None,
        min_length=1,
        description="Several scanners in the cell, each with a name. They replace rig.",
    )
    light: LightSection = LightSection()
    motion: OptionalMotion = None
    domain: DomainSection | None = Field(
        default=None,
        description="How the scenes differ in light, views and materials, in addition to the "
        "poses of their parts.",
    )
    render: RenderSection = RenderSection()
    drop: DropLimits = DropLimits()
    store: StoreSection = StoreSection()

    @field_validator("count", mode="wrap")
    @classmethod
    def _countable(cls, value: Any, check: Callable[[Any], Any]) -> int | tuple[int, int]:
        try:
            count = check(value)
        except ValidationError:
            raise ValueError("give one number of parts, or two numbers [lowest, highest]") from None
        low, high = (count, count) if isinstance(count, int) else count
        if not 0 <= low <= high <= 255:
            raise ValueError("give a number from 0 to 255, or two such numbers [lowest, highest]")
        return count

    @model_validator(mode="after")
    def _one_way_to_count(self) -> "Config":
        if self.fill is not None and self.count != Config.model_fields["count"].default:
            raise ValueError("count and fill both say how many parts lie in a scene: remove one")
        return self

    @model_validator(mode="after")
    def _one_way_to_look(self) -> "Config":
        # Values are compared with defaults, because a configuration from a manifest sets every key.
        used = {"distance_m", "target_m"} if isinstance(self.views, DomeSection) else set()
        if self.views is not None and not isinstance(self.views, JitterSection):
            plain = ViewSection(**self.view.model_dump(include=used))
            if self.view != plain:
                raise ValueError(
                    "view and views both say where the rig hangs: remove view, or take it into "
                    "views"
                )
        if self.scanners is None:
            return self
        own = [*ScannerSections.model_fields, "rig"]
        keys = [name for name in own if getattr(self, name) != Config.model_fields[name].default]
        if keys:
            raise ValueError(
                f"{', '.join(keys)} and scanners are both given: say it in each of the scanners"
            )
        names = [entry.name.lower() for entry in self.scanners]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two scanners are called {twice[0]}: give one another name")
        if self.scanners[0].T_first_cam is not None:
            raise ValueError(
                f"scanner {self.scanners[0].name} is the first one, to which T_first_cam of the "
                "others refers: remove its own T_first_cam"
            )
        return self

    @property
    def count_range(self) -> tuple[int, int]:
        return (self.count, self.count) if isinstance(self.count, int) else self.count


def load_config(path: Path | str) -> Config:
    """Read and check a configuration.

    Raises:
        ConfigError: the file is missing, is not YAML, or has an unknown or wrong key.
    """
    return read_settings(Path(path), Config)


# --- from words to values ----------------------------------------------------------------------


def resolve_parts(
    config: Config, folder: Path, *, progress: ProgressMeter = UNWATCHED
) -> tuple[tuple[Part, ...], tuple[str, ...]]:
    """Return the parts of a configuration, and notes on the parts' meshes.

    Raises:
        ConfigError: an unknown built-in part, or a texture that cannot be read.
        MeshError: a mesh cannot be used as a part.
    """
    parts: list[Part] = []
    notes: list[str] = []
    for section in config.parts:
        if section.mesh is not None:
            progress.stage(f"reading {section.mesh}")
        part, own_notes = resolve_part(section, folder)
        if part.name in {other.name for other in parts}:
            raise ConfigError(f"two parts have the name {part.name}: rename one of them")
        parts.append(part)
        notes.extend(f"{part.name}: {note}" for note in own_notes)
    return tuple(parts), tuple(notes)


def resolve_bin(section: BinSection, folder: Path) -> tuple[Bin, tuple[str, ...]]:
    """Return the bin of a configuration, and notes on the bin's mesh.

    Raises:
        ConfigError, MeshError: a file cannot be used; the error names it.
    """
    own_material = None if section.material is None else resolve_material(section.material, folder)
    floor = None if section.floor is None else resolve_material(section.floor, folder)
    if section.mesh is None:
        material = own_material or Material(texture=wood_texture(), roughness=0.6)
        box = Bin(
            inner_m=section.inner_m,
            wall_m=section.wall_m,
            material=material,
            floor=floor,
            friction=section.friction,
        )
        return box, ()
    loaded = load_bin(folder / section.mesh, unit=section.unit, up=section.up_axis)
    box = Bin(
        inner_m=loaded.inner_m,
        mesh=loaded.mesh,
        own_texture=own_material is None and loaded.material.texture is not None,
        material=own_material or loaded.material,
        floor=floor,
        friction=section.friction,
    )
    return box, tuple(f"bin: {note}" for note in loaded.notes)


def resolve_environment(section: EnvironmentSection, folder: Path) -> Environment:
    if section.map is None:
        return Environment(radiance=section.radiance)
    path = folder / section.map
    if not path.is_file():
        raise ConfigError(f"light.environment.map: no file {path}")
    refuse_large_picture(path, f"light.environment.map {path}", ConfigError)
    return Environment(radiance=section.radiance, map_file=path)


def resolve_scanner(config: Config, folder: Path) -> Scanner:
    """Return the scanner that a configuration names, or the first of several scanners.

    Raises:
        ConfigError: as in `resolve_scanners`.
    """
    return resolve_scanners(config, folder)[0][1]


def resolve_scanners(config: Config, folder: Path) -> tuple[tuple[str, Scanner], ...]:
    """Return every scanner and its name ("" for a single scanner); sections change the scanners.

    Raises:
        ConfigError: there is no such rig, or the code lacks the axis that is parallel to the
            baseline.
    """
    if config.scanners is None:
        return (("", _resolved(config.rig, config, config.resolution, folder)),)
    scanners: list[tuple[str, Scanner]] = []
    for entry in config.scanners:
        try:
            scanner = _resolved(entry.rig, entry, config.resolution, folder)
        except ConfigError as error:
            raise ConfigError(f"scanner {entry.name}: {error}") from error
        if scanners:
            scanner = own_device(scanner, entry, name=entry.name)
        scanners.append((entry.name, scanner))
    return tuple(scanners)


def _resolved(rig: str, sections: ScannerSections, resolution: str, folder: Path) -> Scanner:
    scanner = with_sections(named_scanner(rig, folder=folder, resolution=resolution), sections)
    refuse_blind_code(scanner)
    return scanner


def refuse_blind_code(scanner: Scanner) -> None:
    """Refuse a scanner whose code lacks the axis that is parallel to the baseline.

    Raises:
        ConfigError: the code cannot give depth with this rig.
    """
    axis = triangulation_axis(scanner.rig)
    if axis not in scanner.code.axes:
        axes = ", ".join(scanner.code.axes)
        raise ConfigError(f"code.axes is {axes}: rig {scanner.rig.name} needs {axis} for depth")


def resolve_quality(config: Config) -> Quality:
    return quality_of(config.render)


def quality_of(render: RenderSection) -> Quality:
    """Return the quality settings of the section's renderer."""
    return Quality(
        samples=render.samples,
        depth=render.depth,
        denoise=render.cycles.denoise if render.backend == "cycles" else "none",
    )
