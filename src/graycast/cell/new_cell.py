"""A commented configuration for one part, whose size determines bin, rig and distance."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import ConfigError
from ..base.settings import read_settings, read_text
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
METAL_KG_M3, OTHER_KG_M3 = 7850.0, 1000.0  # densities of parts with a fitted surface: steel, water


@dataclass(frozen=True, slots=True, kw_only=True)
class PartSurface:
    """A material, and the keys of a part in a configuration that state it."""

    material: Material
    density_kg_m3: float
    keys: tuple[str, ...]


def named_surface(name: str) -> PartSurface:
    """Return one of `MATERIALS`.

    Raises:
        ValueError: no material has that name.
    """
    preset = material_preset(name)
    keys = (
        f"material: {name}   # change it to that of your part",
        f"density_kg_m3: {preset.density_kg_m3:g}",
    )
    return PartSurface(material=preset.material, density_kg_m3=preset.density_kg_m3, keys=keys)


def fitted_surface(path: Path) -> PartSurface:
    """Read the material that `graycast real material` wrote; its comments are kept.

    Raises:
        ConfigError: the file is no material, leaves a number open, or names a picture.
    """
    section = read_settings(path, MaterialSection)
    for key in ("base_color", "roughness"):
        if getattr(section, key) is None:
            raise ConfigError(
                f"{path}: has no {key}, so the scan did not determine it: add the key, or fit the "
                "material to a scan that determines it (graycast real material --help)"
            )
    if section.texture is not None or section.roughness_map is not None:
        raise ConfigError(f"{path}: names a picture: copy its keys into cell.yaml by hand")
    material = resolve_material(section, path.parent)
    density_kg_m3 = METAL_KG_M3 if material.metallic > 0 else OTHER_KG_M3
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    keys = (
        f"material:   # from {path.name}",
        *(f"  {line}" for line in lines),
        f"density_kg_m3: {density_kg_m3:g}   # change it to that of your part",
    )
    return PartSurface(material=material, density_kg_m3=density_kg_m3, keys=keys)


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
            texture. The part's own density is then written, too, if `source` is a mesh.
    """
    inner_m = bin_for(part)
    box = Bin(inner_m=inner_m)
    framing = best_framing(box)
    full = max(1, round(full_count(part, inner_m)))
    most = int(np.clip(round(HEAP_SHARE * full), 3, MOST_PARTS))
    # JSON is valid YAML, even if the name of a file has a colon, a hash or a quote.
    keys = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in source.items()]
    if surface is not None:
        keys += surface.keys
        if "mesh" in source and shape_symmetry(part.mesh) != Symmetry():
            keys.append("symmetry: {auto: true}   # remove it if print or colour tells sides apart")
    elif "mesh" in source:
        keys.append(f"density_kg_m3: {part.density_kg_m3:g}   # change it to that of your part")
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
