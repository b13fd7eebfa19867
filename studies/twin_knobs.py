"""What each doubtful knob of a scanner buys its twin, for docs/twin.md.

python -m studies.phoxi_twin --scans 0 1 2 --out out/phoxi
python -m studies.twin_knobs out/phoxi/cell.yaml --out out/phoxi/knobs.json

A search with all parameters begins at the start with noise of the surface, with the code of 12 px.
At its end begin the searches with one knob off or none, with its slopes, by damped Gauss-Newton
steps. Broyden's update corrects the slopes after each step. With all knobs off, the search begins
at the start with slopes of its own and makes twice as many steps. The classifier judges the scans
that were fitted and those kept aside, in several draws of the twins' noise.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from graycast.base.progress import UNWATCHED
from graycast.camera.scanner import Scanner
from graycast.cell.config import load_config, resolve_quality
from graycast.cell.resolve import Cell, open_cell_renderer, resolve_cell
from graycast.real.picture_pairs import read_rgb
from graycast.real.realism import DepthScan, read_scans, sensor_auc
from graycast.real.realism.patches import Squares, cut_squares, find_floor
from graycast.real.realism.two_sample import PLACES, depth_step_m
from graycast.real.twin.making import fitted_parameters
from graycast.real.twin.parameters import (
    Parameter,
    candidate_codes,
    shares_of,
    values_at,
    with_noise_of_surface,
    with_values,
)
from graycast.real.twin.restaging import restage
from graycast.real.twin.rows import Figures, Places, figures_of, pulls_of
from graycast.real.twin.searching import _Court, _slopes, scans_of
from graycast.real.twin.stage import Lit, light_scenes, missing_places

from .phoxi_twin import REAL

FITTED, ASIDE = (0, 1, 2), (3, 4)
LEVER, DAMPING, LEAST_WAY = 0.1, 10.0, 1e-3  # of the steps, as shares of the ranges
# What switches each knob off; None where its section says null.
KNOBS: Mapping[str, float | None] = {
    "faults.raster_window_px": None,
    "faults.raster_window_share": 1.0,
    "faults.raster_limit_m": None,
    "faults.raster_unevenness": None,
    "faults.raster_line_unevenness": None,
    "faults.edge_x_px": None,
    "faults.edge_y_px": None,
    "line_noise_length_m": math.inf,
    "speckle_unevenness": 0.0,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """What all searches have in common: the scenes under light, and the real scans with their
    statistics and squares."""

    start: Scanner
    parameters: tuple[Parameter, ...]
    lit: tuple[Lit, ...]
    real: Figures
    places: Places
    squares: Mapping[str, Squares]
    step_m: float


def open_bench(cell: Cell) -> Bench:
    """Stage the scenes of five scans, render them for one code, and measure the real scans."""
    files = [REAL / f"depth_{i}.npy" for i in (*FITTED, *ASIDE)]
    scans = list(read_scans(files, K=cell.scanner.rig.camera.K))
    pictures = [read_rgb(REAL / f"color_{i}.png") for i in (*FITTED, *ASIDE)]
    code = candidate_codes(cell.scanner.code)[-1]
    start = replace(cell.scanner, code=code)
    with open_cell_renderer(cell) as renderer:
        lit = light_scenes(
            cell,
            restage(scans, cell.scene, pictures),
            (code,),
            seed=0,
            renderer=renderer,
            quality=resolve_quality(cell.config),
            rougher=(-0.15, 0.0, 0.15),
            names=[scan.name for scan in scans],
            progress=UNWATCHED,
        )
    own = scans[: len(FITTED)]
    places = missing_places(lit[: len(FITTED)], own)
    step_m = depth_step_m(own)
    return Bench(
        start=start,
        parameters=fitted_parameters(cell),
        lit=lit,
        real=figures_of(own, find_floor([scan.depth_m for scan in own]), places),
        places=places,
        squares={
            "fitted": cut_squares(own, step_m=step_m),
            "aside": cut_squares(scans[len(FITTED) :], step_m=step_m),
        },
        step_m=step_m,
    )


def without(scanner: Scanner, parameters: Sequence[Parameter], off: Collection[str]) -> Scanner:
    """The scanner with these knobs off."""
    for parameter in parameters:
        if parameter.key in off:
            value = KNOBS[parameter.key]
            own = replace(parameter, off_below=math.inf if value is None else None, off_above=None)
            scanner = with_values(scanner, (own,), {own.key: value or 0.0})
    return scanner


@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """Where a search ended: shares by the parameters' keys, and the slopes of the rows there."""

    share: Mapping[str, float]
    slopes: Float[np.ndarray, "rows n"]
    result: dict[str, Any]


def search_without(
    bench: Bench, off: Collection[str], base: End | None, *, steps: int, draws: int
) -> End:
    """Search with some knobs off, and judge what was found.

    Args:
        base: where it begins, with its slopes; None for the start with slopes of its own.
    """
    began = time.monotonic()
    kept = [i for i, p in enumerate(bench.parameters) if p.key not in off]
    parameters = tuple(bench.parameters[i] for i in kept)
    start = without(bench.start, bench.parameters, off)
    lit, code = bench.lit[: len(FITTED)], start.code
    court = _Court(start, lit, parameters, bench.real, bench.places, 0, 0, UNWATCHED)

    def pulls(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " rows"]:
        return pulls_of(court.judge(code, x)[1])

    if base is None:
        x = with_noise_of_surface(shares_of(start, parameters), parameters)
        slopes = _slopes(pulls, x, pulls(x), LEVER, np.full(len(x), True))
    else:
        x = np.array([base.share[p.key] for p in parameters])
        slopes = base.slopes[:, kept]
    first = court.loss(code, x)
    x, slopes = descend(pulls, x, slopes, steps)
    loss, rows = court.judge(code, x)
    values = values_at(x, parameters)
    result: dict[str, Any] = {
        "off": sorted(off),
        "parameters": len(parameters),
        "before": first,
        "misfit": loss,
        "met": sum(row.is_met for row in rows),
        "of": len(rows),
        "auc": judge(bench, with_values(start, parameters, values), values, draws),
        "values": values,
        "rows": {row.name: [row.real, row.spread, row.twin] for row in rows},
        "seconds": round(time.monotonic() - began),
    }
    share = {p.key: float(s) for p, s in zip(parameters, x, strict=True)}
    return End(share=share, slopes=slopes, result=result)


def descend(
    pulls: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " rows"]],
    x: Float[np.ndarray, " n"],
    slopes: Float[np.ndarray, "rows n"],
    steps: int,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "rows n"]]:
    """The best place of so many damped steps, and the corrected slopes."""
    here, slopes, damping = pulls(x), slopes.copy(), DAMPING
    for _ in range(steps):
        normal = slopes.T @ slopes + damping * np.eye(len(x))
        moved = np.clip(x - np.linalg.solve(normal, slopes.T @ here), 0.0, 1.0)
        way = moved - x
        if np.linalg.norm(way) < LEAST_WAY:
            break
        found = pulls(moved)
        slopes += np.outer(found - here - slopes @ way, way) / (way @ way)
        if (found**2).mean() < (here**2).mean():
            x, here, damping = moved, found, damping / 3
        else:
            damping *= 4
    return x, slopes


def judge(
    bench: Bench, scanner: Scanner, values: dict[str, float], draws: int
) -> dict[str, dict[str, Any]]:
    """The AUC by place, and the share of pixels with depth, of each set of scans: one for each draw
    of the noise."""
    cut = len(FITTED)
    found: dict[str, dict[str, Any]] = {}
    for name, lit in (("fitted", bench.lit[:cut]), ("aside", bench.lit[cut:])):
        each: dict[str, Any] = {place: [] for place in (*PLACES, "coverage")}
        for draw in range(draws):
            seed = 100_000 + 1_000 * draw
            made: list[DepthScan] = list(scans_of(lit, scanner, values, seed=seed, name="twin"))
            squares = cut_squares(made, step_m=bench.step_m)
            for place in PLACES:
                auc = sensor_auc(bench.squares[name], squares, place, seed=draw)
                each[place].append(auc)
            each["coverage"].append(float(np.mean([scan.valid.mean() for scan in made])))
        found[name] = each
    return found


def table(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The rows of the page's table, in Markdown."""
    columns = [(name, place) for name in ("fitted", "aside") for place in PLACES]
    heads = ["off", "misfit", "met", *(f"{place}, {name}" for name, place in columns)]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for title, one in results.items():
        auc = [np.array(one["auc"][name][place], dtype=float) for name, place in columns]
        cells = [f"{a.mean():.2f} ± {a.std(ddof=1):.2f}" for a in auc]
        first = [title, f"{one['misfit']:.2f}", f"{one['met']} of {one['of']}"]
        lines.append("| " + " | ".join([*first, *cells]) + " |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description="Search twins with single knobs off.")
    parser.add_argument("cell", type=Path, help="The file cell.yaml of studies.phoxi_twin.")
    parser.add_argument("--out", type=Path, required=True, help="The JSON file of the results.")
    parser.add_argument("--steps", type=int, default=10, help="Steps of each search.")
    parser.add_argument("--draws", type=int, default=3, help="Draws of noise for the classifier.")
    options = parser.parse_args()
    cell = resolve_cell(load_config(options.cell), options.cell.parent)
    bench = open_bench(cell)
    results: dict[str, dict[str, Any]] = {}
    all_off = search_without(bench, list(KNOBS), None, steps=2 * options.steps, draws=options.draws)
    base = search_without(bench, [], None, steps=options.steps, draws=1)
    results["all of these"] = all_off.result
    singles: dict[str, list[str]] = {"nothing": []} | {key: [key] for key in KNOBS}
    for title, off in singles.items():
        end = search_without(bench, off, base, steps=options.steps, draws=options.draws)
        results[title] = end.result
        options.out.write_text(json.dumps(results, indent=1), encoding="utf-8")
        print(table({title: end.result})[-1], f"{end.result['seconds']} s", flush=True)
    print("\n".join(table(results)))


if __name__ == "__main__":
    main()
