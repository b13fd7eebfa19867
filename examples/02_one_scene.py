"""One scene from Python, without files: drop, render, expose, decode, and compare with the truth.

Run: .venv/bin/python examples/02_one_scene.py
"""

import sys
from pathlib import Path

import numpy as np

from graycast.camera.decode import Reason
from graycast.cell.config import Config
from graycast.cell.resolve import open_cell_renderer, resolve_cell
from graycast.cell.simulate import make_scene


def main(samples: int) -> None:
    config = Config.model_validate(
        {
            "parts": [{"builtin": "toothpaste"}],
            "count": 5,
            "rig": "phoxi-m",
            "render": {"samples": samples},
        }
    )
    cell = resolve_cell(config, Path())
    with open_cell_renderer(cell) as renderer:
        shot = make_scene(cell, 0, seed=1, renderer=renderer)

    scanner, truth = shot.sample.scanner_depth, shot.sample.truth
    error_mm = 1000 * (scanner.depth_m - truth.depth_m)
    longest_ms = 1000 * np.max(shot.capture.exposure_s)
    print(f"{shot.capture.frames.shape[0]} frames, exposed for up to {longest_ms:.2f} ms")
    print(f"median error {np.nanmedian(np.abs(error_mm)):.2f} mm")
    for reason in Reason:
        print(f"{reason.name.lower():18} {np.mean(scanner.reason == reason):6.1%}")


if __name__ == "__main__":
    main(samples=int(sys.argv[1]) if len(sys.argv) > 1 else 16)
