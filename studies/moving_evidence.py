"""The evidence that the correlation of taken back pictures gives about a depth.

python -m studies.moving_evidence out/moving_evidence

Fits `POWER` of `camera/decode/evidence/wrong.py` to the heaps of seed 1, in addition to the
evidence of its table, and prints it with the ratio for which both densities have the sum 1. `RATIO`
is smaller, because the decoder's second pass raises probabilities: with 7, the presets keep about
as much depth as with a limit of 0.95 on the correlation. The table has the share of the parts'
pixels with depth, and the share of it that is wrong [%], without and with the evidence. Heaps of
seeds 2 and 3 are new to the fit. The folder stores the scans (a minute each), so that a second run
only decodes.
"""

import argparse
import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.special import logit

import graycast as gc
from benchmarks.stages import cell_of
from graycast.base.frames import inverse
from graycast.base.tables import markdown_table
from graycast.camera.decode import TakenBack, levels_of, take_back, without_doubt
from graycast.camera.scanner import Scanner, decode_capture
from graycast.camera.sensor import Capture
from graycast.cell.motion import MotionSection, pose_at
from graycast.cell.simulate import on_part
from graycast.rendering import PathNoise

PHOXI, ZIVID = "like-phoxi-m", "like-zivid-2-m70"
FITTED = (
    *((PHOXI, "gray_phase", (v, 0.0, 0.0), 1) for v in (0.02, 0.05, 0.1)),
    (PHOXI, "gray_phase", (0.01, 0.01, 0.03), 1),
    *((PHOXI, "multi_frequency", (v, 0.0, 0.0), 1) for v in (0.02, 0.05)),
    (ZIVID, "gray_phase", (0.05, 0.0, 0.0), 1),
)
CHECKED = (
    (PHOXI, "gray_phase", (0.05, 0.0, 0.0), 2),
    (PHOXI, "gray_phase", (0.07, 0.07, 0.0), 3),
    (ZIVID, "gray_phase", (0.02, 0.0, 0.0), 2),
    (ZIVID, "gray_phase", (0.1, 0.0, 0.0), 2),
    (ZIVID, "multi_frequency", (0.05, 0.0, 0.0), 3),
)
LIKELY = 0.1  # Only pixels below this probability count for the fit: others are removed anyway.


@dataclass(frozen=True, slots=True, kw_only=True)
class MovingScan:
    """A scan whose pictures were taken back by the true motion."""

    scanner: Scanner
    capture: Capture
    path_noise: PathNoise | None
    back: TakenBack
    part: Bool[np.ndarray, "h w"]
    true_m: Float[np.ndarray, "h w"]


def moving_scan(rig: str, codec: str, belt: tuple[float, ...], seed: int) -> MovingScan:
    motion = MotionSection(belt_m_s=belt, picture_s=0.02)
    cell = cell_of(
        {
            "count": 12,
            "rig": rig,
            "resolution": "small",
            "bin": {"inner_m": [0.30, 0.22, 0.08]},
            "exposure": {"factors": [1.0]},
            "code": {"codec": codec, "axes": ["column"]},
            "render": {"samples": 32},
            "motion": motion.model_dump(),
        }
    )
    with gc.open_cell_renderer(cell) as renderer:
        shot = gc.make_scene(cell, 0, seed=seed, renderer=renderer)
    sample, record = shot.sample, shot.sample.manifest["motion"]
    middle_s = np.array(record["start_s"][0]) + record["exposure_s"][0] / 2
    T = sample.scene.T_world_cam
    return MovingScan(
        scanner=cell.scanner,
        capture=shot.capture,
        path_noise=shot.rendering.radiance.path_noise,
        back=take_back(
            shot.capture.frames,
            cell.scanner.light_code(),
            cell.scanner.rig,
            np.stack([inverse(pose_at(T, motion, float(t))) @ T for t in middle_s]),
            saturation_dn=levels_of(cell.scanner.sensor).saturation_dn,
        ),
        part=on_part(sample.scene, sample.layout, sample.truth),
        true_m=sample.truth.depth_m,
    )


def stored(folder: Path, scene: tuple[str, str, tuple[float, ...], int]) -> MovingScan:
    path = folder / ("_".join(map(str, scene)) + ".pickle")
    if not path.is_file():
        path.write_bytes(pickle.dumps(moving_scan(*scene)))
    scan: MovingScan = pickle.loads(path.read_bytes())
    return scan


def evidence(scan: MovingScan) -> Float[np.ndarray, "4 n"]:
    """Return log odds of the table, log(1 - r), wrong depth and weight of each pixel of a scan."""
    scanner, frames = scan.scanner, scan.back.frames
    at_rest = gc.Capture(frames=frames, sensor=scanner.sensor, exposure_s=scan.capture.exposure_s)
    codes, depth = decode_capture(scanner, at_rest, path_noise=scan.path_noise)
    of_code = scanner.rig, frames, scanner.light_code(), levels_of(scanner.sensor)
    depth = without_doubt(codes, depth, *of_code, max_p_wrong=LIKELY)[1]
    known = scan.part & np.isfinite(depth.depth_m) & np.isfinite(scan.true_m)
    assert depth.p_wrong is not None
    p_wrong = depth.p_wrong[known].astype(float)
    x = np.log(np.maximum(1 - scan.back.correlation[known], 1e-5))
    wrong = depth.is_wrong(scan.true_m)[known]
    return np.stack([logit(p_wrong), x, wrong, np.full(len(x), 1 / len(x))])


def fit(pixels: Float[np.ndarray, "4 n"]) -> tuple[float, float]:
    """Return the ratio and the power of the most likely evidence."""
    before, x, wrong, weight = pixels

    def misfit(law: Float[np.ndarray, "2"]) -> float:
        after = before + law[0] + law[1] * x
        return float((weight * (np.logaddexp(0, after) - wrong * after)).sum())

    power = minimize(misfit, [0.0, 0.5]).x[1]
    of_right = weight * (1 - wrong)
    return float(of_right.sum() / (of_right * np.exp(power * x)).sum()), float(power)


def shares(scan: MovingScan, back: TakenBack) -> str:
    depth = gc.measure(scan.scanner, scan.capture, path_noise=scan.path_noise, back=back)[1]
    known = scan.part & np.isfinite(depth.depth_m) & np.isfinite(scan.true_m)
    wrong = depth.is_wrong(scan.true_m)[known].mean()
    return f"{100 * known.sum() / scan.part.sum():.1f}; {100 * wrong:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description="The evidence of correlation in moving scenes.")
    parser.add_argument("folder", type=Path, help="A folder for the scans.")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    ratio, power = fit(np.hstack([evidence(stored(folder, scene)) for scene in FITTED]))
    print(f"ratio {ratio:.1f}, power {power:.2f}")
    rows = []
    for rig, codec, belt, seed in (*FITTED, *CHECKED):
        scan = stored(folder, (rig, codec, belt, seed))
        none = np.full_like(scan.back.correlation, np.nan)
        alone = TakenBack(frames=scan.back.frames, correlation=none)
        name = f"{rig}, {codec}, {' '.join(map(str, belt))} m/s, seed {seed}"
        rows.append([name, shares(scan, alone), shares(scan, scan.back)])
        print(*rows[-1], flush=True)
    print(markdown_table(["scene", "without", "with"], rows))


if __name__ == "__main__":
    main()
