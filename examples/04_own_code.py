"""Define your own code, which is any list of frames, and compare its depth with the truth.

This code has eleven frames. Gray bits count periods of 60 projector columns, a complementary bit
distinguishes the halves of a period, and three phase steps give the position inside a period.

Run: .venv/bin/python examples/04_own_code.py
"""

import sys
from dataclasses import replace

import numpy as np

import graycast

PERIOD_PX, STEPS = 60.0, 3


def own_code(width_px: int, height_px: int) -> graycast.Code:
    """Return a code whose frames are in the order of projection."""
    bits = int(np.ceil(np.log2(width_px / PERIOD_PX)))
    halves = graycast.Frame(kind="complementary", axis="column", period_px=PERIOD_PX)
    frames = [graycast.Frame(kind="white"), graycast.Frame(kind="black")]
    frames += [graycast.Frame(kind="gray", axis="column", bit=b) for b in reversed(range(bits))]
    frames += [halves, *(replace(halves, kind="phase", step=k, steps=STEPS) for k in range(STEPS))]
    return graycast.Code(
        width_px=width_px,
        height_px=height_px,
        frames=tuple(frames),
        stride_px=(PERIOD_PX, 1.0),  # The Gray code counts periods, not columns.
    )


def main(samples: int) -> None:
    config = graycast.Config(
        parts=(graycast.PartSection(builtin="toothpaste"),),
        count=5,
        rig="like-phoxi-m",
        resolution="small",
        render=graycast.RenderSection(samples=samples),
    )
    cell = graycast.load_cell(config)
    projector = cell.scanner.rig.projector
    code = own_code(projector.width_px, projector.height_px)
    # This sensor is noisier than the rig's; a dataset's manifests record the sensor and the code.
    sensor = replace(cell.scanner.sensor, read_noise_e=6.0)
    cell = cell.with_own(code=code, sensor=sensor)

    (scene,) = graycast.scenes(cell, 1, seed=1)
    error_mm = 1000 * np.abs(scene.depth.depth_m - scene.truth.depth_m)
    decoded = np.isfinite(error_mm)
    print(f"{len(code.frames)} frames, {decoded.mean():.1%} of the pixels decoded")
    print(f"median error {np.median(error_mm[decoded]):.3f} mm")


if __name__ == "__main__":
    main(samples=int(sys.argv[1]) if len(sys.argv) > 1 else 16)
