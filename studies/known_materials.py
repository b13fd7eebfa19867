"""Materials fitted to simulated scans of known materials, for docs/measurements/surfaces.md.

python -m studies.known_materials out/known
python -m studies.known_materials out/known --classes
python -m studies.known_materials out/known --rig like-zivid-2plus-m60 --distance 0.63

Each scan shows a heap of 20 built-in metal parts with the preset in a matt grey bin, whose
reflectance of 0.5 is the reference. Scans that exist in the folder are used again.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

import graycast as gc
from graycast.base.errors import GraycastError
from graycast.base.tables import markdown_table
from graycast.real.material import (
    MaterialFit,
    divide,
    fit_material,
    open_scan,
    read_masks,
    scale_of,
)
from graycast.rig.pair import Rig
from graycast.world.parts import MATERIALS

GREY = 0.5
SEED = 5
APART_PX = 4  # The reference is this far from parts, since their light reaches the bin.
NAMES = (
    "aluminium-cast", "steel", "zinc", "copper", "brass", "cast-iron", "steel-black-oxide", "rust",
    "plastic", "abs-black", "pom-black", "pom-white", "rubber", "paper", "cardboard",
    "steel-polished", "stainless-polished", "chrome",
)  # fmt: skip
HEADINGS = ["material", "kind", "roughness", "fitted [95 %]", "base colour", "fitted [95 %]"]
CLASS_HEADINGS = ["material", "classes", "pixels of parts", "right", "pixels of the bin", "right"]


def configuration(
    name: str, rig: str, distance_m: float | None = None, *, depth: int = 4
) -> gc.Config:
    """Return the cell of a material; with a depth of 1, no part lights another one."""
    matt = {"base_color": (GREY,) * 3, "specular": 0.0, "roughness": 1.0}
    return gc.Config(
        parts=(gc.PartSection(builtin="metal_workpiece_1", material=name),),
        count=20,
        rig=rig,
        resolution="small",
        bin={"inner_m": (0.30, 0.22, 0.08), "material": matt},
        table=matt,
        store={"frames": True},
        render={"denoise": False, "depth": depth},
        view={"distance_m": distance_m},
    )


def scanned(name: str, rig: str, distance_m: float | None, folder: Path) -> Path:
    """Make the scan of a material, if it does not exist; return its scene."""
    out = folder / f"{rig}-{name}"
    config = configuration(name, rig, distance_m)
    gc.generate(gc.load_cell(config), out, scenes=1, seed=SEED)
    return out / "train" / "000000"


def fitted(scene: Path) -> tuple[MaterialFit, Rig]:
    """Fit the material of the parts of a scene, with the matt bin as the reference."""
    scan = open_scan(scene / "frames")
    parts = read_masks(sorted((scene / "mask_sl").glob("000000_*.png")))
    scale = scale_of(scan.observations(away_from(parts)), GREY)
    return fit_material(scan.observations(parts), scale=scale, seed=0), scan.scanner.rig


def away_from(parts: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    disc = np.ones((2 * APART_PX + 1,) * 2, dtype=np.uint8)
    return cv2.dilate(parts.astype(np.uint8), disc) == 0


def row_of(name: str, rig: str, distance_m: float | None, folder: Path) -> list[str]:
    """Return the true and the fitted numbers of a material, or the error of the fit."""
    material = MATERIALS[name].material
    scene = scanned(name, rig, distance_m, folder)
    try:
        fit, own = fitted(scene)
    except GraycastError as error:
        return [name, "refused", f"{material.roughness:g}", str(error).partition(":")[0], "", ""]
    weights = np.array(own.band_weights) / sum(own.band_weights)
    color = float(weights @ material.base_color)
    cells = [
        f"{number.value:.3f} ({number.low:.3f} to {number.high:.3f})"
        for number in (fit.roughness, fit.color)
    ]
    return [name, fit.kind, f"{material.roughness:g}", cells[0], f"{color:.3f}", cells[1]]


def division_of(name: str, rig: str, distance_m: float | None, folder: Path) -> list[str]:
    """Divide a scan without masks; compare the class of the reference with the true masks."""
    scene = scanned(name, rig, distance_m, folder)
    scan = open_scan(scene / "frames")
    parts = read_masks(sorted((scene / "mask_sl").glob("000000_*.png")))
    white = away_from(parts)
    observations = scan.observations()
    scale = scale_of(scan.observations(white), GREY)
    division = divide(observations, scale=scale, seed=0)
    place = tuple(observations.pixel.T)
    number = division.most(white[place])
    assert number is not None
    reference = division.members(number)
    cells = [name, f"{division.count}"]
    for inside, right in ((parts[place], ~reference), (~parts[place], reference)):
        inside = inside & (division.label >= 0)
        cells += [f"{inside.sum()}", f"{right[inside].mean():.1%}"]
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="A folder for the scans.")
    parser.add_argument("--rig", default="like-phoxi-m", help="The preset of the scanner.")
    parser.add_argument(
        "--distance",
        type=float,
        metavar="METRES",
        help="The distance of the scanner. Without it, the lines of sight of camera and projector "
        "meet in the bin, or at the end of the working range.",
    )
    parser.add_argument("--materials", nargs="+", default=NAMES, metavar="NAME", help="Presets.")
    parser.add_argument("--classes", action="store_true", help="Divide the scans without masks.")
    arguments = parser.parse_args()
    row = division_of if arguments.classes else row_of
    rows = [
        row(name, arguments.rig, arguments.distance, arguments.folder)
        for name in arguments.materials
    ]
    print(markdown_table(CLASS_HEADINGS if arguments.classes else HEADINGS, rows))


if __name__ == "__main__":
    main()
