"""Depth on a moving belt: decoded and wrong share by speed, as taken and with pictures taken back.

python -m studies.belt_speed [--codes CODE ...]

Prints the table of docs/measurements/motion.md: 12 brackets at `small`, 64 paths per pixel, columns
only, one exposure, and a picture every 20 ms. The belt moves along the baseline. Each cell has the
decoded share of the parts' pixels [%], the share of it that is wrong [%], and the median error
[um]; the last column is the error of the estimated velocity [%], which is first assumed 20 % too
low.
"""

import argparse
from itertools import product

import numpy as np
from jaxtyping import Bool

import graycast as gc
from benchmarks.stages import cell_of
from graycast.base.frames import inverse
from graycast.base.tables import markdown_table
from graycast.camera.decode import (
    WRONG_M,
    WRONG_SIGMAS,
    DepthMap,
    levels_of,
    steady_motion,
    steady_transforms,
    take_back,
)
from graycast.cell.motion import MotionSection, pose_at
from graycast.cell.simulate import on_part
from graycast.rendering import GroundTruth

SPEEDS_M_S = (0.0, 0.02, 0.05, 0.1)
PICTURE_S = 0.02
ASSUMED = 0.8  # The share of the true velocity from which the estimate starts.
RIGS = ("like-phoxi-m", "like-zivid-2-m70")
CODES = ("gray_phase", "multi_frequency")


def shares(depth: DepthMap, truth: GroundTruth, part: Bool[np.ndarray, "h w"]) -> str:
    """Return the decoded share of the parts' pixels and the share of it that is wrong [%]."""
    error_m = np.abs(depth.depth_m - truth.depth_m)
    known = np.isfinite(error_m) & part
    wrong = known & (error_m > WRONG_M) & (error_m > WRONG_SIGMAS * depth.sigma_m)
    median_um = 1e6 * np.median(error_m[known]) if known.any() else np.nan
    decoded, spoilt = known.sum() / part.sum(), wrong.sum() / max(known.sum(), 1)
    return f"{100 * decoded:.0f}; {100 * spoilt:.1f}; {median_um:.0f}"


def figures(rig: str, codec: str, speed_m_s: float) -> list[str]:
    """Return the shares as taken, with the known and with the estimated motion, and its error."""
    motion = MotionSection(belt_m_s=(speed_m_s, 0.0, 0.0), picture_s=PICTURE_S)
    cell = cell_of(
        {
            "count": 12,
            "rig": rig,
            "resolution": "small",
            "bin": {"inner_m": [0.30, 0.22, 0.08]},
            "exposure": {"factors": [1.0]},
            "code": {"codec": codec, "axes": ["column"]},
            "render": {"samples": 64},
            "motion": motion.model_dump(),
        }
    )
    with gc.open_cell_renderer(cell) as renderer:
        shot = gc.make_scene(cell, 0, seed=1, renderer=renderer)
    sample, record = shot.sample, shot.sample.manifest["motion"]
    middle_s = np.array(record["start_s"][0]) + record["exposure_s"][0] / 2
    T = sample.scene.T_world_cam
    T_then_now = np.stack([inverse(pose_at(T, motion, float(t))) @ T for t in middle_s])
    part = on_part(sample.scene, sample.layout, sample.truth)
    noise = shot.rendering.radiance.path_noise
    true_m_s = T_then_now[-1, :3, 3] / middle_s[-1]
    scanner, frames = cell.scanner, shot.capture.frames
    code, top_dn = scanner.light_code(), levels_of(scanner.sensor).saturation_dn
    start_m_s = ASSUMED * true_m_s
    estimate_m_s = steady_motion(frames, code, scanner.rig, middle_s, start_m=start_m_s)
    depths = [sample.scanner_depth]
    for T in (T_then_now, steady_transforms(estimate_m_s, middle_s)):
        back = take_back(frames, code, scanner.rig, T, saturation_dn=top_dn)
        depths.append(gc.measure(scanner, shot.capture, path_noise=noise, back=back)[1])
    off_m_s, speed = np.linalg.norm(estimate_m_s - true_m_s), np.linalg.norm(true_m_s)
    off = f"{100 * off_m_s / speed:.1f}" if speed_m_s else f"{1e3 * off_m_s:.2g} mm/s"
    return [*(shares(depth, sample.truth, part) for depth in depths), off]


def main() -> None:
    parser = argparse.ArgumentParser(description="Depth on a moving belt, by its speed.")
    codes = "The codes to scan with (default: %(default)s)."
    parser.add_argument("--codes", nargs="+", default=["gray_phase"], choices=CODES, help=codes)
    options = parser.parse_args()
    head = ["rig", "code", "speed [m/s]", "as taken", "known", "estimated", "off"]
    rows = []
    for rig, code, speed_m_s in product(RIGS, options.codes, SPEEDS_M_S):
        rows.append([rig, code, f"{speed_m_s:g}", *figures(rig, code, speed_m_s)])
        print(*rows[-1], flush=True)
    print(markdown_table(head, rows))


if __name__ == "__main__":
    main()
