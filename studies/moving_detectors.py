"""Write three cells for docs/measurements/motion.md: brackets on a belt at rest and in motion.

python -m studies.moving_detectors out/moving

The pictures are those of `like-phoxi-m` at `small`, cropped to the bin so that many scenes are
affordable. The head of `configs/detector/moving.yaml` has the commands that make datasets of the
cells, and train and score detectors.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

import graycast as gc

CROP_PX = (258, 193)  # width and height
RANGE_M = (0.65, 1.0)  # The decoder tries all depths of the range, so a shorter one is faster.
CELL = {
    "parts": [{"builtin": "metal_workpiece_1"}],
    "count": [8, 16],
    "bin": {"inner_m": [0.30, 0.22, 0.08]},
    "rig": "rig.yaml",
    "code": {"axes": ["column"], "period_px": 96, "fine_period_px": 32},
    "exposure": {"factors": [1.0]},
}
# The wide stripes allow renders that are four pixels of the projector apart.
MOTION = {"belt_m_s": [0.05, 0.0, 0.0], "picture_s": 0.02, "render_px": 4}
CELLS: dict[str, dict[str, Any]] = {
    "still": {},
    "as_taken": {"motion": MOTION},
    "taken_back": {"motion": MOTION | {"compensate": True}},
}


def cropped(scanner: gc.Scanner) -> gc.Scanner:
    """Return the scanner with the middle of its picture and a shorter range."""
    camera, (width_px, height_px) = scanner.rig.camera, CROP_PX
    camera = replace(
        camera,
        width_px=width_px,
        height_px=height_px,
        cx_px=camera.cx_px - (camera.width_px - width_px) / 2,
        cy_px=camera.cy_px - (camera.height_px - height_px) / 2,
    )
    near_m, far_m = RANGE_M
    rig = replace(scanner.rig, camera=camera, near_m=near_m, far_m=far_m)
    return replace(scanner, rig=rig)


def main() -> None:
    parser = argparse.ArgumentParser(description="Write three cells of brackets on a belt.")
    parser.add_argument("folder", type=Path, help="A folder for the configurations.")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    gc.save_scanner(cropped(gc.preset("like-phoxi-m", "small")), folder / "rig.yaml")
    for name, motion in CELLS.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(CELL | motion))


if __name__ == "__main__":
    main()
