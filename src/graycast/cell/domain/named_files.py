"""The files that a domain names: maps, textures and distractors."""

from dataclasses import dataclass, replace
from pathlib import Path

from ...base.errors import ConfigError
from ...base.file_limits import refuse_large_picture
from ...base.folder import visible_entries
from ...base.public_value import public_value
from ...world.parts import Part, builtin_part
from ...world.parts.part_sections import resolve_part
from ...world.scene import Scene, bin_of
from .domain_sections import AdaptedSection, DistractorRanges, RandomizedSection

MAPS, PICTURES = (".exr", ".hdr"), (".png", ".jpg", ".jpeg")
METAL_PARTS = ("metal_workpiece_1", "metal_workpiece_2")
SMALL = 0.5  # Default distractors are shorter than this share of the bin's shorter side.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Domain:
    """Settings of a domain with the files that they name, sorted by name."""

    section: AdaptedSection | RandomizedSection
    maps: tuple[Path, ...] = ()
    bin_textures: tuple[Path, ...] = ()
    table_textures: tuple[Path, ...] = ()
    distractors: tuple[Part, ...] = ()
    notes: tuple[str, ...] = ()  # notes about the distractors' meshes


def resolve_domain(
    section: AdaptedSection | RandomizedSection, folder: Path, *, scene: Scene
) -> Domain:
    """Return the domain of the cell `scene`; the configuration's paths are relative to `folder`.

    Raises:
        ConfigError: a folder has no pictures, or a distractor is one of the cell's parts.
        MeshError: a distractor's mesh cannot be a part.
    """
    if isinstance(section, AdaptedSection):
        return Domain(section=section)
    distractors, notes = _distractors(section.distractors, folder, scene)
    files = {
        name: tuple(folder / path for path in paths)
        for name, paths in _folders(section, folder).items()
    }
    return Domain(section=section, distractors=distractors, notes=notes, **files)


def domain_files(
    section: AdaptedSection | RandomizedSection | None, folder: Path
) -> tuple[Path, ...]:
    """Return every file that a domain names, relative to `folder`.

    Raises:
        ConfigError: a folder does not exist or has no pictures.
    """
    if not isinstance(section, RandomizedSection):
        return ()
    named: list[Path | None] = [
        path for paths in _folders(section, folder).values() for path in paths
    ]
    for part in (section.distractors and section.distractors.parts) or ():
        named += [part.mesh, *([] if part.material is None else part.material.files.values())]
    return tuple(dict.fromkeys(path for path in named if path is not None))


def _folders(section: RandomizedSection, folder: Path) -> dict[str, tuple[Path, ...]]:
    """Return the pictures of each folder by field of `Domain`, relative to `folder`."""
    light, box, table = section.environment, section.bin, section.table
    named = {
        "maps": (None if light is None else light.maps, MAPS, "environment.maps"),
        "bin_textures": (None if box is None else box.textures, PICTURES, "bin.textures"),
        "table_textures": (None if table is None else table.textures, PICTURES, "table.textures"),
    }
    return {
        field: () if path is None else _listed(folder, path, endings, key)
        for field, (path, endings, key) in named.items()
    }


def _listed(folder: Path, path: Path, endings: tuple[str, ...], key: str) -> tuple[Path, ...]:
    if not (folder / path).is_dir():
        raise ConfigError(f"domain.{key}: no folder {folder / path}: check the path")
    names = [entry.name for entry in visible_entries(folder / path) if entry.is_file()]
    paths = tuple(path / name for name in names if Path(name).suffix.lower() in endings)
    if not paths:
        raise ConfigError(
            f"domain.{key}: {folder / path} has no {' or '.join(endings)} file: add at least one"
        )
    for file in paths:
        refuse_large_picture(folder / file, f"domain.{key}: {folder / file}", ConfigError)
    return paths


def _distractors(
    ranges: DistractorRanges | None, folder: Path, scene: Scene
) -> tuple[tuple[Part, ...], tuple[str, ...]]:
    if ranges is None or ranges.count[1] == 0:
        return (), ()
    taken = {part.name for part in scene.parts}
    if ranges.parts is None:
        opening_m = min(bin_of(scene).inner_m[:2])
        others = (builtin_part(name) for name in METAL_PARTS if name not in taken)
        small = tuple(part for part in others if part.mesh.extent_m.max() <= SMALL * opening_m)
        return tuple(replace(part, labelled=False) for part in small), ()
    parts: list[Part] = []
    notes: list[str] = []
    for section in ranges.parts:
        part, own_notes = resolve_part(section, folder)
        if part.name in taken:
            raise ConfigError(
                f"domain.distractors.parts: there is another part {part.name}: give it another "
                "name, or take it out"
            )
        taken.add(part.name)
        parts.append(replace(part, labelled=False))
        notes.extend(f"{part.name}: {note}" for note in own_notes)
    return tuple(parts), tuple(notes)
