"""Depth on a moving belt: decoded and wrong share by speed, as taken and with pictures taken back.

python -m studies.belt_speed [--codes CODE ...] [--speeds M_S ...] [--pictures FOLDER]

Prints the table of docs/measurements/motion.md: 12 brackets at `small`, 64 paths per pixel, columns
only, one exposure, and a picture every 20 ms. The belt moves along the baseline. Each cell has the
decoded share of the parts' pixels [%], the share of it that is wrong [%], and the median error
[um]; the last column is the error of the estimated velocity [%], which is first assumed 20 % too
low.
"""

import argparse
import pickle
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

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
from graycast.rendering import GroundTruth, PathNoise

SPEEDS_M_S = (0.0, 0.02, 0.05, 0.1, 0.2)
PICTURE_S = 0.02
ASSUMED = 0.8  # The share of the true velocity from which the estimate starts.
RIGS = ("like-phoxi-m", "like-zivid-2-m70")
CODES = ("gray_phase", "multi_frequency", "micro_phase")


def shares(depth: DepthMap, truth: GroundTruth, part: Bool[np.ndarray, "h w"]) -> str:
    """Return the decoded share of the parts' pixels and the share of it that is wrong [%]."""
    error_m = np.abs(depth.depth_m - truth.depth_m)
    known = np.isfinite(error_m) & part
    wrong = known & (error_m > WRONG_M) & (error_m > WRONG_SIGMAS * depth.sigma_m)
    median_um = 1e6 * np.median(error_m[known]) if known.any() else np.nan
    decoded, spoilt = known.sum() / part.sum(), wrong.sum() / max(known.sum(), 1)
    return f"{100 * decoded:.0f}; {100 * spoilt:.1f}; {median_um:.0f}"


class Scan(NamedTuple):
    """The pictures of one scan of the moving scene, with their ground truth."""

    scanner: gc.Scanner
    capture: gc.Capture
    path_noise: PathNoise | None
    truth: GroundTruth
    part: Bool[np.ndarray, "h w"]
    middle_s: Float[np.ndarray, " n"]
    T_then_now: Float[np.ndarray, "n 4 4"]


def scan(rig: str, codec: str, speed_m_s: float) -> Scan:
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
    return Scan(cell.scanner, shot.capture, noise, sample.truth, part, middle_s, T_then_now)


def stored_scan(rig: str, codec: str, speed_m_s: float, folder: Path | None) -> Scan:
    """Return the scan that the folder has; render and store it if the folder lacks it."""
    if folder is None:
        return scan(rig, codec, speed_m_s)
    path = folder / f"{rig}_{codec}_{speed_m_s:g}.pickle"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        # A plain tuple can be read without this module.
        path.write_bytes(pickle.dumps(tuple(scan(rig, codec, speed_m_s))))
    return Scan(*pickle.loads(path.read_bytes()))


def figures(taken: Scan) -> list[str]:
    """Return the shares as taken, with the known and with the estimated motion, and its error."""
    scanner, frames, middle_s = taken.scanner, taken.capture.frames, taken.middle_s
    true_m_s = taken.T_then_now[-1, :3, 3] / middle_s[-1]
    code, top_dn = scanner.light_code(), levels_of(scanner.sensor).saturation_dn
    start_m_s = ASSUMED * true_m_s
    estimate_m_s = steady_motion(frames, code, scanner.rig, middle_s, start_m=start_m_s)
    stacks = [frames]
    for T in (taken.T_then_now, steady_transforms(estimate_m_s, middle_s)):
        stacks.append(take_back(frames, code, scanner.rig, T, saturation_dn=top_dn))
    cells = []
    for stack in stacks:
        capture = replace(taken.capture, frames=stack)
        depth = gc.measure(scanner, capture, path_noise=taken.path_noise)[1]
        cells.append(shares(depth, taken.truth, taken.part))
    off_m_s, speed = np.linalg.norm(estimate_m_s - true_m_s), np.linalg.norm(true_m_s)
    moves = speed > 1e-9  # At rest, the speed is only a rounding error.
    off = f"{100 * off_m_s / speed:.1f}" if moves else f"{1e3 * off_m_s:.2g} mm/s"
    return [*cells, off]


def main() -> None:
    parser = argparse.ArgumentParser(description="Depth on a moving belt, by its speed.")
    for name, type_, default in (
        ("rigs", str, RIGS),
        ("codes", str, CODES[:1]),
        ("speeds", float, SPEEDS_M_S),
    ):
        words = f"The {name} of the table (default: %(default)s)."
        parser.add_argument(f"--{name}", nargs="+", default=default, type=type_, help=words)
    store = "A folder that stores the pictures, so that a second run only decodes."
    parser.add_argument("--pictures", type=Path, help=store)
    options = parser.parse_args()
    head = ["rig", "code", "speed [m/s]", "as taken", "known", "estimated", "off"]
    rows = []
    for rig, code, speed_m_s in product(options.rigs, options.codes, options.speeds):
        taken = stored_scan(rig, code, speed_m_s, options.pictures)
        rows.append([rig, code, f"{speed_m_s:g}", *figures(taken)])
        print(*rows[-1], flush=True)
    print(markdown_table(head, rows))


if __name__ == "__main__":
    main()
