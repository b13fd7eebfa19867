"""Simulated scans of bins with parts and with walls without depth: docs/measurements/fit-bin.md.

python -m studies.simulated_bins --bins 20             boxes
python -m studies.simulated_bins --bins 20 --crates    crates with leaning walls
"""

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float

from graycast.base.frames import inverse
from graycast.cell.config import Config
from graycast.cell.resolve import Cell, resolve_cell
from graycast.cell.simulate import make_scene
from graycast.real.fit_bin import fit_pose, shape_of
from graycast.real.fit_bin.bin_views import BinView
from graycast.rendering import Quality, open_renderer
from graycast.world.scene import EMPTY_LAYOUT, bin_of

from .crates import Crate
from .smaller import shrunk

LOST = 0.30  # share of the inner walls' pixels that lose their depth


def small_cell(size_px: tuple[int, int] = (344, 258), **words: Any) -> Cell:
    """Return a cell with the paper's rig, but fewer pixels on the same field."""
    content = {"parts": [{"builtin": "metal_workpiece_1"}]} | words
    cell = resolve_cell(Config.model_validate(content), Path())
    rig = cell.scene.rig
    rig = replace(rig, camera=shrunk(rig.camera, *size_px))
    scanner = replace(cell.scanner, rig=rig)
    return replace(cell, scene=replace(cell.scene, rig=rig), scanner=scanner)


def random_cell(rng: np.random.Generator, folder: Path | None) -> tuple[Cell, Crate]:
    """Return a random bin with 3 to 8 parts, viewed with up to 30 degrees of tilt.

    With a folder for its file, the bin is a mesh with leaning walls, else a box. The returned crate
    has the same walls.
    """
    length, width, height = rng.uniform([0.30, 0.22, 0.10], [0.50, 0.38, 0.22]).round(3).tolist()
    view = {
        "tilt_deg": rng.uniform(0, 30),
        "azimuth_deg": rng.uniform(-40, 40),
        "distance_m": rng.uniform(0.75, 1.0),
        "target_m": [*rng.uniform(-0.05, 0.05, 2).tolist(), height / 3],
    }
    crate, wall_m = Crate(inner_m=(length, width, height), lean=0.0), rng.uniform(0.003, 0.02)
    if folder is None:
        box = {"inner_m": [length, width, height], "wall_m": wall_m}
    else:
        crate = replace(crate, lean=rng.uniform(0.0, 0.12), rim_m=rng.uniform(0.005, 0.02))
        box = {"mesh": crate.write(folder / "crate.stl"), "unit": "mm"}
    if rng.random() < 0.6:  # else wood
        box["material"] = {
            "base_color": rng.uniform(0.1, 0.7, 3).tolist(),
            "roughness": rng.uniform(0.3, 0.8),
        }
    cell = small_cell(view=view, bin=box, count=[3, 8], render={"samples": 16, "denoise": False})
    return cell, crate


def measured(cell: Cell, renderer, *, seed: int) -> BinView:
    """Simulate a scan of the bin with its parts."""
    shot = make_scene(cell, 0, seed=seed, renderer=renderer)
    return BinView(
        name="simulated", camera=cell.scene.rig.camera, depth_m=shot.sample.scanner_depth.depth_m
    )


def wall_pixels(cell: Cell, crate: Crate, view: BinView, renderer, *, seed: int) -> np.ndarray:
    """Return the inner wall that each pixel shows (1 to 4; 0 elsewhere), from ground truth."""
    nothing = np.zeros(
        (0, cell.scene.rig.projector.height_px, cell.scene.rig.projector.width_px), np.uint8
    )
    truth = renderer.render(
        cell.scene, EMPTY_LAYOUT, nothing, quality=Quality(samples=1, depth=1), seed=seed
    ).truth
    camera, T = view.camera, cell.scene.T_world_cam
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    ray = np.stack([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px], -1)
    point = np.concatenate([ray, np.ones_like(ray[..., :1])], -1) * truth.depth_m[..., None]
    world = point @ T[:3, :3].T + T[:3, 3]
    half, height = np.array(crate.inner_m[:2]) / 2, crate.inner_m[2]
    label = np.zeros(truth.depth_m.shape, dtype=int)
    between = (world[..., 2] > 1e-4) & (world[..., 2] < height - 1e-4)
    for number, (axis, sign) in enumerate([(0, 1), (0, -1), (1, 1), (1, -1)], start=1):
        beyond_m = sign * world[..., axis] - half[axis] - crate.lean * world[..., 2]
        label[between & (np.abs(beyond_m) < 1e-4)] = number
    return label


def lose_walls(
    depth_m: np.ndarray, label: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Remove the depth of walls in random order until the share `LOST` of their pixels is gone.

    The last wall loses only a part: adjacent columns or rows, counted along its longer side.
    """
    lost, wanted = np.zeros(label.shape, dtype=bool), LOST * (label > 0).sum()
    for number in rng.permutation(4) + 1:
        y, x = np.nonzero(label == number)
        missing = round(float(wanted - lost.sum()))
        if missing <= 0 or not len(y):
            continue
        along = np.argsort(x if np.ptp(x) > np.ptp(y) else y, kind="stable")
        if rng.random() < 0.5:
            along = along[::-1]
        lost[y[along[:missing]], x[along[:missing]]] = True
    return np.where(lost, np.nan, depth_m), float(lost.sum() / max((label > 0).sum(), 1))


def fit_one(number: int, renderer, *, seed: int, crates: bool = False) -> dict[str, Any]:
    """Fit one random bin; return the error of the pose and the figures of the fit."""
    rng = np.random.default_rng([seed, number])
    with TemporaryDirectory() as folder:
        cell, crate = random_cell(rng, Path(folder) if crates else None)
    view = measured(cell, renderer, seed=int(rng.integers(1 << 31)))
    label = wall_pixels(cell, crate, view, renderer, seed=0)
    depth_m, lost = lose_walls(view.depth_m, label, rng)
    view = replace(view, depth_m=depth_m)
    azimuth = np.radians(cell.config.view.azimuth_deg)
    fit = fit_pose([view], shape_of(bin_of(cell.scene)), azimuth_rad=azimuth, seed=0)
    off_m, off_deg = wrong_by(fit.pose.T_world_cam, cell.scene.T_world_cam)
    return {
        "off_mm": 1e3 * off_m,
        "off_deg": off_deg,
        "lost": lost,
        "rms_mm": 1e3 * fit.pose.rms_m,
        "inliers": fit.pose.inlier_share,
        "sigma_mm": 1e3 * float(np.linalg.norm(fit.pose.sigma[:3])),
        "edges": ", ".join(fit.pose.by_edges),
        "loose": ", ".join(fit.pose.loose),
    }


def wrong_by(
    estimate: Float[np.ndarray, "4 4"], true: Float[np.ndarray, "4 4"]
) -> tuple[float, float]:
    """Return the distance [m] and the angle [deg] between two poses of a bin."""
    T_a, T_b = inverse(estimate), inverse(true)
    cosine = (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1) / 2
    off_m = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
    return off_m, float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def study(
    bins: int, renderer, *, seed: int, crates: bool = False, on_bin=print
) -> list[dict[str, Any]]:
    rows = []
    for number in range(bins):
        rows.append(fit_one(number, renderer, seed=seed, crates=crates))
        on_bin(f"{number:3} " + " ".join(f"{k} {v}" if isinstance(v, str) else f"{k} {v:.3f}"
                                         for k, v in rows[-1].items()))  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description="Fit the poses of simulated bins.")
    parser.add_argument("--bins", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--crates", action="store_true", help="meshes with leaning walls")
    options = parser.parse_args()
    with open_renderer("mitsuba", device="cpu") as renderer:
        rows = study(options.bins, renderer, seed=options.seed, crates=options.crates)
    good = sum(row["off_mm"] < 1 and row["off_deg"] < 0.3 for row in rows)
    off, turned = ([row[k] for row in rows] for k in ("off_mm", "off_deg"))
    print(
        f"within 1 mm and 0.3 degrees: {good} of {len(rows)}; median {np.median(off):.2f} mm and "
        f"{np.median(turned):.3f} degrees, worst {max(off):.2f} mm and {max(turned):.3f} degrees"
    )


if __name__ == "__main__":
    main()
