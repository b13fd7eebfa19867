"""Make a scene in Python without files: drop, render, expose, decode, compare with the truth.

Run: .venv/bin/python examples/02_one_scene.py
"""

import sys

import numpy as np

import graycast as gc


def main(samples: int) -> None:
    config = gc.Config(
        parts=(gc.PartSection(builtin="toothpaste"),),
        count=5,
        rig="like-phoxi-m",
        render=gc.RenderSection(samples=samples),
    )
    for scene in gc.scenes(gc.load_cell(config), 1, seed=1):
        error_mm = 1000 * (scene.depth.depth_m - scene.truth.depth_m)
        longest_ms = 1000 * np.max(scene.capture.exposure_s)
        print(f"{len(scene.capture.frames)} frames, exposed for up to {longest_ms:.2f} ms")
        print(f"median error {np.nanmedian(np.abs(error_mm)):.2f} mm")
        for reason in gc.Reason:
            print(f"{reason.name.lower():18} {np.mean(scene.depth.reason == reason):6.1%}")


if __name__ == "__main__":
    main(samples=int(sys.argv[1]) if len(sys.argv) > 1 else 16)
