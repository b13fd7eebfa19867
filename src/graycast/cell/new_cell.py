"""A commented configuration for one part, whose size determines bin, rig and distance."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import ConfigError
from ..base.settings import check_settings, parse_yaml, read_text
from ..rig.pair import BINNING
from ..world.parts import Material, Part, Symmetry, full_count, material_preset
from ..world.parts.material_section import MaterialSection, resolve_material
from ..world.parts.symmetry import shape_symmetry
from ..world.scene import Bin
from .framing import Framing, best_framing, part_width_px

BIN_LENGTHS = 5.0  # inner length of the bin in lengths of the part
BIN_M = (0.12, 1.0)  # inner lengths of the smallest and of the largest bin
HEAP_SHARE = 1 / 3  # A scene has at most this share of the parts that would fill the bin.
# The highlights and the dark sides of a metal need a wider bracket than the rig's.
_METAL_EXPOSURE = "exposure: {auto: true}   # chosen from each picture: up to 5, which take longer"
SMALL_SHARE = 0.5  # A bin that covers less of the picture looks like a wrong choice of the scanner.
MOST_PARTS = 60  # The time of a drop grows with the parts in a scene.
_FITTED = ("base_color", "metallic", "roughness")  # keys that a fit determines or leaves out


@dataclass(frozen=True, slots=True, kw_only=True)
class PartSurface:
    """A material, and the lines of a part in a configuration that state it.

    A scan does not determine the density; it is then None.
    """

    material: Material
    density_kg_m3: float | None
    lines: tuple[str, ...]


def named_surface(name: str) -> PartSurface:
    """Return one of `MATERIALS`.

    Raises:
        ValueError: no material has that name.
    """
    preset = material_preset(name)
    lines = (f"material: {name}   # change it to that of your part",)
    return PartSurface(material=preset.material, density_kg_m3=preset.density_kg_m3, lines=lines)


def fitted_surface(path: Path) -> PartSurface:
    """Read the material that `graycast real material` wrote; its comments are kept.

    Raises:
        ConfigError: the file is no fitted material, lacks a key, names a picture, or has lines that
            cannot be copied.
    """
    text = read_text(path)
    content = parse_yaml(text, path)
    section = check_settings(content, MaterialSection, path)
    missing = [key for key in _FITTED if getattr(section, key) is None]
    if len(missing) == len(_FITTED):
        raise ConfigError(
            f"{path}: is no fitted material, which has the keys {', '.join(_FITTED)}: give a file "
            "that graycast real material wrote, or name a material with --surface"
        )
    if missing:
        raise ConfigError(
            f"{path}: has no {' and no '.join(missing)}, so the scan did not determine it: add the "
            "key, or fit a scan that determines it (graycast real material --help)"
        )
    if section.files:
        raise ConfigError(
            f"{path}: {', '.join(section.files)} names a picture: copy the keys into cell.yaml by "
            "hand"
        )
    try:
        material = resolve_material(section, path.parent)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    # A byte order mark, and the marks of a document, are not allowed inside a section.
    own = text.removeprefix("\ufeff").splitlines()
    own = [f"  {line}" for line in own if line.strip() not in ("", "---", "...")]
    parse_yaml("\n".join(own), path)  # This call refuses any other line that a section cannot have.
    lines = (f"material:   # from {path.name!r}", *own)
    return PartSurface(material=material, density_kg_m3=None, lines=lines)


def new_cell(
    name: str,
    part: Part,
    source: Mapping[str, str],
    *,
    surface: PartSurface | None,
    scenes: int = 10,
) -> str:
    """Return the text of a configuration.

    Args:
        name: the folder's name, for the commands in the first lines of the text.
        part: the part, whose size is used.
        source: the keys of `parts` that name its origin.
        surface: the surface of the part; None keeps the part's own material, such as a mesh's
            texture. A surface without a density keeps the part's own density.
    """
    inner_m = bin_for(part)
    box = Bin(inner_m=inner_m)
    framing = best_framing(box)
    full = max(1, round(full_count(part, inner_m)))
    most = int(np.clip(round(HEAP_SHARE * full), 3, MOST_PARTS))
    # JSON is valid YAML, even if the name of a file has a colon, a hash or a quote.
    keys = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in source.items()]
    if surface is not None:
        keys += surface.lines
    if surface is not None and surface.density_kg_m3 is not None:
        keys.append(f"density_kg_m3: {surface.density_kg_m3:g}")
    elif "mesh" in source:
        keys.append(f"density_kg_m3: {part.density_kg_m3:g}   # change it to that of your part")
    if surface is not None and "mesh" in source and shape_symmetry(part.mesh) != Symmetry():
        keys.append("symmetry: {auto: true}   # remove it if print or colour tells sides apart")
    size = " x ".join(f"{1e3 * side:.0f}" for side in part.mesh.extent_m)
    room = ", ".join(f"{side:.2f}" for side in inner_m)
    cell, picture, dataset = (
        shlex.quote(f"{name}/{file}") for file in ("cell.yaml", "preview.png", "dataset")
    )
    metal = surface is not None and surface.material.metallic > 0
    exposure = f"{_METAL_EXPOSURE}\n" if metal else ""
    return f"""\
# A cell for {part.name} ({size} mm). `graycast schema config` explains every key.
#   graycast preview {cell} --out {picture}     draws one scene
#   graycast live {cell}     shows the cell in a browser
#   graycast generate {cell} --out {dataset}     makes the dataset
# {framing_text(framing, part, box)}
parts:
  - {f"{chr(10)}    ".join(keys)}

count: [{max(1, most // 2)}, {most}]   # parts in a scene; about {full} fill the bin
scenes: {scenes}
bin:
  inner_m: [{room}]   # length, width and height inside
rig: {framing.rig.name}   # graycast rig list has others
view:
  distance_m: {framing.distance_m:.2f}   # change or remove it for another rig
resolution: low   # small, low or full
{exposure}"""


def bin_for(part: Part) -> tuple[float, float, float]:
    """Return the inner length, width and height of a bin for a part, in whole centimetres."""
    length_m = float(np.clip(BIN_LENGTHS * part.mesh.extent_m.max(), *BIN_M))
    length, width, height = (round(100 * length_m * share) / 100 for share in (1, 0.75, 0.375))
    return length, width, height


def framing_text(framing: Framing, part: Part, box: Bin) -> str:
    """Return a line with the chosen rig, and the sizes of bin and part in the rig's picture.

    If the bin fits no scanner, the line says how much is missing. If it covers little of the
    picture, the line says that the same is true for every scanner.

    Args:
        framing: the best scanner of the shelf.
    """
    width_px = part_width_px(part, framing.rig.camera, framing.T_world_cam, box)
    small_px = width_px * BINNING["full"] / BINNING["small"]
    line = (
        f"{framing.rig.name} at {framing.distance_m:.2f} m: the bin fills "
        f"{100 * framing.bin_share:.0f} % of the picture, a part is {width_px:.0f} px wide at "
        f"full, {small_px:.0f} px at small"
    )
    if framing.missing_m <= 0 and framing.bin_share >= SMALL_SHARE:
        return line
    if framing.missing_m <= 0:
        return (
            f"{line}; this bin is small: with every scanner of the shelf, it fills at most "
            f"{100 * framing.best_share:.0f} % of the picture"
        )
    return (
        f"{line}; no scanner of the shelf holds the whole bin, and this one is nearest: it lacks "
        f"{1e3 * framing.missing_m:.0f} mm"
    )
