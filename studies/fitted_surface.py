"""Three cells of one world for docs/measurements/surfaces.md: preset, fitted and true surface.

python -m studies.fitted_surface out/surface

The true surface is metal; a seed gives its base colour and its roughness. The command simulates one
scan of it, fits the material as `graycast real material` does, and writes the configurations
`preset.yaml`, `fitted.yaml` and `truth.yaml`. The head of `configs/detector/surface.yaml` has the
commands that train detectors with each and score them in the true world.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import graycast as gc
from benchmarks.stages import cell_of
from graycast.real.material import fit_material, open_scan, read_masks, scale_of
from studies.known_materials import GREY, away_from

SEED = 0
PRESET = "steel"  # What a user writes who knows only that the part is steel.


def random_metal(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    grey, roughness = float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.15, 0.5))
    return {"base_color": [grey] * 3, "roughness": roughness, "metallic": 1.0}


def settings(material: str | dict[str, Any]) -> dict[str, Any]:
    """Return the configuration of a heap of brackets of one material in a matt grey bin."""
    matt = {"base_color": [GREY] * 3, "specular": 0.0, "roughness": 1.0}
    return {
        "parts": [{"builtin": "metal_workpiece_1", "material": material}],
        "count": [10, 25],
        "rig": "like-phoxi-m",
        "resolution": "small",
        "bin": {"inner_m": [0.30, 0.22, 0.08], "material": matt},
        "table": matt,
    }


def fitted_material(truth: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Fit the material to one scan of the true world, which is simulated into a folder."""
    cell = cell_of(settings(truth) | {"store": {"frames": True}})
    gc.generate(cell, folder, scenes=1, seed=SEED)
    scene = folder / "train" / "000000"
    scan = open_scan(scene / "frames")
    parts = read_masks(sorted((scene / "mask_sl").glob("000000_*.png")))
    scale = scale_of(scan.observations(away_from(parts)), GREY)
    fit = fit_material(scan.observations(parts), scale=scale, seed=0)
    print(f"fitted: {fit.kind}, roughness {fit.roughness}, base colour {fit.color}")
    metallic = float(fit.kind == "metal")
    return {
        "base_color": [fit.color.value] * 3,
        "roughness": fit.roughness.value,
        "metallic": metallic,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="A folder for the scan and the configurations.")
    folder = parser.parse_args().folder
    truth = random_metal(SEED)
    print(f"true: {truth}")
    fit = fitted_material(truth, folder / "scan")
    materials: dict[str, str | dict[str, Any]] = {"preset": PRESET, "fitted": fit, "truth": truth}
    for name, material in materials.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(settings(material)))


if __name__ == "__main__":
    main()
