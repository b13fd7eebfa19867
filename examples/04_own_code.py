"""A code of the user: any list of frames. This one has eleven, and is compared with the truth.

Gray bits count periods of 60 projector columns, a complementary bit distinguishes their halves, and
three phase steps give the place inside a period.

Run: .venv/bin/python examples/04_own_code.py
"""

import sys
from dataclasses import replace

import numpy as np

import graycast
from graycast.camera.decode import levels_of
from graycast.camera.light import camera_light
from graycast.camera.sensor import auto_exposure_s, expose

PERIOD_PX, STEPS = 60.0, 3


def own_code(width_px: int, height_px: int) -> graycast.Code:
    """The frames in the order in which they are shown."""
    bits = int(np.ceil(np.log2(width_px / PERIOD_PX)))
    halves = graycast.Frame(kind="complementary", axis="column", period_px=PERIOD_PX)
    frames = [graycast.Frame(kind="white"), graycast.Frame(kind="black")]
    frames += [graycast.Frame(kind="gray", axis="column", bit=b) for b in reversed(range(bits))]
    frames += [halves, *(replace(halves, kind="phase", step=k, steps=STEPS) for k in range(STEPS))]
    return graycast.Code(
        width_px=width_px,
        height_px=height_px,
        frames=tuple(frames),
        stride_px=(PERIOD_PX, 1.0),  # the Gray code counts periods, not columns
    )


def main(samples: int) -> None:
    parts = (graycast.PartSection(builtin="toothpaste"),)
    cell = graycast.load_cell(graycast.Config(parts=parts, rig="like-phoxi-m", resolution="small"))
    scene, sensor = cell.scene, cell.scanner.sensor
    code = own_code(scene.rig.projector.width_px, scene.rig.projector.height_px)

    layout = graycast.drop(scene, (5,), seed=1, limits=graycast.DropLimits())
    quality = graycast.Quality(samples=samples)
    rendering = graycast.render(scene, layout, code.render(), quality=quality, seed=2)
    light, background = camera_light(rendering.radiance, scene.rig)
    brightest = light[code.brightest] + background
    exposure_s = auto_exposure_s(brightest, sensor, percentile=99.0, target=0.8)
    capture = expose(light, background, sensor, exposure_s=exposure_s, seed=3)
    codes = graycast.decode(capture.frames, code, cell.scanner.decode, levels_of(sensor))
    depth = graycast.triangulate(codes, scene.rig)

    error_mm = 1000 * np.abs(depth.depth_m - rendering.truth.depth_m)
    decoded = np.isfinite(error_mm)
    print(f"{len(code.frames)} frames, {decoded.mean():.1%} of the pixels decoded")
    print(f"median error {np.median(error_mm[decoded]):.3f} mm")


if __name__ == "__main__":
    main(samples=int(sys.argv[1]) if len(sys.argv) > 1 else 16)
