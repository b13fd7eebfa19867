"""A commented configuration for one part: bin, number of parts and rig are fitted to its size."""

import json
import shlex
from collections.abc import Mapping
from itertools import product

import numpy as np

from ..base.frames import inverse, transform_points
from ..camera.scanner import preset
from ..rig.optics import Optics, project
from ..rig.pair import Rig
from ..world.parts import Part, Symmetry, full_count, material_preset
from ..world.parts.symmetry import shape_symmetry
from ..world.scene import Bin
from .views import ViewSection, hang

# They go from the smallest field to the largest.
RIGS = ("like-phoxi-s", "like-phoxi-m", "like-phoxi-l")
BIN_LENGTHS = 5.0  # The bin is so many parts long inside.
BIN_M = (0.12, 1.0)  # The smallest and the largest bin are so long.
HEAP_SHARE = 1 / 3  # A scene has at most this share of the parts that would fill the bin.
MOST_PARTS = 60  # The time of a drop grows with the parts in a scene.


def new_cell(
    name: str, part: Part, source: Mapping[str, str], *, surface: str | None, scenes: int = 10
) -> str:
    """Return the text of a configuration.

    Args:
        name: of the folder, for the commands in its first lines.
        part: as it is read, to know its size.
        source: the keys of `parts` that say where it comes from.
        surface: one of `MATERIALS`; None keeps the part's own material, as of a mesh with a
            texture. The part's own density is then written, too, if `source` is a mesh.

    Raises:
        ValueError: no material has that name.
    """
    inner_m = bin_for(part)
    rig_name, covers = rig_for(Bin(inner_m=inner_m))
    full = max(1, round(full_count(part, inner_m)))
    most = int(np.clip(round(HEAP_SHARE * full), 3, MOST_PARTS))
    # Text of JSON is text of YAML, also where a file's name has a colon, a hash or a quote.
    keys = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in source.items()]
    if surface is not None:
        density_kg_m3 = material_preset(surface).density_kg_m3
        keys.append(f"material: {surface}   # change it to that of your part")
        keys.append(f"density_kg_m3: {density_kg_m3:g}")
        if shape_symmetry(part.mesh) != Symmetry():
            keys.append("symmetry: {auto: true}   # remove it if print or colour tells sides apart")
    elif "mesh" in source:
        keys.append(f"density_kg_m3: {part.density_kg_m3:g}   # change it to that of your part")
    size = " x ".join(f"{1e3 * side:.0f}" for side in part.mesh.extent_m)
    room = ", ".join(f"{side:.2f}" for side in inner_m)
    cell, picture, dataset = (
        shlex.quote(f"{name}/{file}") for file in ("cell.yaml", "preview.png", "dataset")
    )
    field = "its field holds the bin" if covers else "the bin is larger than its field"
    return f"""\
# A cell for {part.name} ({size} mm). `graycast schema config` explains every key.
#   graycast preview {cell} --out {picture}     draws one scene
#   graycast live {cell}     shows the cell in a browser
#   graycast generate {cell} --out {dataset}     makes the dataset
parts:
  - {f"{chr(10)}    ".join(keys)}

count: [{max(1, most // 2)}, {most}]   # parts in a scene; about {full} fill the bin
scenes: {scenes}
bin:
  inner_m: [{room}]   # length, width and height inside
rig: {rig_name}   # graycast rig list has others; of {", ".join(RIGS)}: {field}
resolution: low   # small, low or full
"""


def bin_for(part: Part) -> tuple[float, float, float]:
    """Length, width and height inside of a bin for a part, in whole centimetres."""
    length_m = float(np.clip(BIN_LENGTHS * part.mesh.extent_m.max(), *BIN_M))
    length, width, height = (round(100 * length_m * share) / 100 for share in (1, 0.75, 0.375))
    return length, width, height


def rig_for(room: Bin) -> tuple[str, bool]:
    """The first of `RIGS` that sees and lights the whole bin from where it hangs by default.

    Returns:
        Its name, and whether it does; otherwise it is the rig with the largest field.
    """
    fit = next((name for name in RIGS if _sees(preset(name).rig, room)), None)
    return fit or RIGS[-1], fit is not None


def _sees(rig: Rig, room: Bin) -> bool:
    length_m, width_m, height_m = room.inner_m
    corner_m = np.array(
        list(product((-length_m / 2, length_m / 2), (-width_m / 2, width_m / 2), (0, height_m)))
    )
    in_camera = transform_points(inverse(hang(ViewSection(), rig, room)), corner_m)
    near_enough = (in_camera[:, 2] > rig.near_m) & (in_camera[:, 2] < rig.far_m)
    in_projector = transform_points(inverse(rig.T_cam_proj), in_camera)
    return bool(
        near_enough.all()
        and _inside(rig.camera, in_camera)
        and _inside(rig.projector, in_projector)
    )


def _inside(optics: Optics, point_m: np.ndarray) -> bool:
    x, y = project(optics, point_m).T
    return bool(((x > 0) & (x < optics.width_px) & (y > 0) & (y < optics.height_px)).all())
