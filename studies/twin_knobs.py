"""The gain of a twin from each part of the fitted scanner, for docs/measurements/twin.md.

python -m studies.phoxi_twin --scans 0 1 2 --out out/phoxi
python -m studies.twin_knobs out/phoxi/cell.yaml --out out/phoxi/knobs.json

The first search fits all parameters. In each other search, one part of the scanner is off, and its
parameter is not fitted. All use the code of 12 px, the same seed and the same number of trials.
Classifiers compare each twin with the fitted scans and with the others, for several seeds of noise.
"""

import argparse
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from graycast.base.progress import UNWATCHED
from graycast.base.tables import markdown_table
from graycast.camera.scanner import Scanner
from graycast.cell.config import load_config
from graycast.cell.resolve import Cell, open_cell_renderer, resolve_cell
from graycast.real.depth_file import FileOptions
from graycast.real.picture_pairs import read_rgb
from graycast.real.realism import DepthScan, read_scans
from graycast.real.realism.patches import Squares, cut_squares, find_floor
from graycast.real.realism.two_sample import PLACES, depth_step_m, sensor_auc
from graycast.real.twin.making import COATS, fitted_parameters
from graycast.real.twin.parameters import Parameter, candidate_codes, with_values
from graycast.real.twin.restaging import restage
from graycast.real.twin.rows import Figures, figures_of
from graycast.real.twin.searching import scans_of, search
from graycast.real.twin.stage import LitScene, light_scenes, missing_places

from .phoxi_twin import REAL

FITTED, ASIDE = (0, 1, 2), (3, 4)
OFF = 0.0  # This value turns off the effect of each parameter below.
KNOBS = (
    "projector.falloff",
    "speckle_contrast",
    "speckle_unevenness",
    "line_noise",
    "filters.smoothing_px",
    "faults.raster_px",
    "faults.raster_line_unevenness",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """The common inputs of all searches: rendered scenes, and the figures of the scans."""

    start: Scanner
    parameters: tuple[Parameter, ...]
    lit: tuple[LitScene, ...]
    real: Figures
    squares: Mapping[str, Squares]
    step_m: float


def open_bench(cell: Cell) -> Bench:
    """Stage the scenes of five scans, render them for one code, and measure the real scans."""
    files = [REAL / f"depth_{i}.npy" for i in (*FITTED, *ASIDE)]
    scans = list(read_scans(files, options=FileOptions(K=cell.scanner.rig.camera.K)))
    pictures = [read_rgb(REAL / f"color_{i}.png") for i in (*FITTED, *ASIDE)]
    code = candidate_codes(cell.scanner.named_code())[-1]
    with open_cell_renderer(cell) as renderer:
        lit = light_scenes(
            cell,
            restage(scans, cell.scene, pictures),
            (code,),
            seed=0,
            renderer=renderer,
            rougher=COATS,
            names=[scan.name for scan in scans],
            progress=UNWATCHED,
        )
    return bench_of(cell, scans, lit)


def bench_of(cell: Cell, scans: list[DepthScan], lit: tuple[LitScene, ...]) -> Bench:
    """Measure the real scans; the first ones are fitted, and the others kept aside."""
    own, aside = scans[: len(FITTED)], scans[len(FITTED) :]
    places = missing_places(lit[: len(FITTED)], own)
    step_m = depth_step_m(own)
    return Bench(
        start=replace(cell.scanner, code=candidate_codes(cell.scanner.named_code())[-1]),
        parameters=fitted_parameters(cell),
        lit=lit,
        real=figures_of(own, find_floor([scan.depth_m for scan in own]), places),
        squares={
            name: cut_squares(some, step_m=step_m)
            for name, some in (("fitted", own), ("aside", aside))
        },
        step_m=step_m,
    )


def search_without(
    bench: Bench, off: Collection[str], *, trials: int, draws: int
) -> dict[str, Any]:
    """Search with some parameters off, and compare the twin found with the scans."""
    gone = [p for p in bench.parameters if p.key in off]
    fit = search(
        with_values(bench.start, gone, dict.fromkeys(off, OFF)),
        bench.lit[: len(FITTED)],
        (bench.start.named_code(),),
        [p for p in bench.parameters if p.key not in off],
        bench.real,
        trials=trials,
        seed=0,
    )
    return {
        "off": sorted(off),
        "trials": fit.trials,
        "misfit": fit.loss,
        "met": [sum(row.is_met for row in rows) for rows in (fit.before, fit.after)],
        "of": len(fit.after),
        "auc": judge(bench, fit.scanner, fit.values, draws),
        "estimates": {e.parameter.key: [e.value, e.low, e.high] for e in fit.estimates},
        "rows": {row.name: [row.real, row.spread, row.twin] for row in fit.after},
    }


def judge(
    bench: Bench, scanner: Scanner, values: dict[str, float], draws: int
) -> dict[str, dict[str, Any]]:
    """Return, for each set of scans and draw, the AUC by place and the share with depth."""
    cut = len(FITTED)
    judgement: dict[str, dict[str, Any]] = {}
    for name, lit in (("fitted", bench.lit[:cut]), ("aside", bench.lit[cut:])):
        each: dict[str, Any] = {place: [] for place in (*PLACES, "coverage")}
        for draw in range(draws):
            seed = 100_000 + 1_000 * draw
            scans = list(scans_of(lit, scanner, values, seed=seed, name="twin"))
            squares = cut_squares(scans, step_m=bench.step_m)
            for place in PLACES:
                auc = sensor_auc(bench.squares[name], squares, place, seed=draw)
                each[place].append(auc)
            each["coverage"].append(float(np.mean([scan.valid.mean() for scan in scans])))
        judgement[name] = each
    return judgement


def table_of(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the table of the page as Markdown."""
    columns = [(name, place) for name in ("fitted", "aside") for place in PLACES]
    heads = ["off", "misfit", "met", *(f"{place}, {name}" for name, place in columns)]
    rows = []
    for title, one in results.items():
        auc = [np.array(one["auc"][name][place], dtype=float) for name, place in columns]
        cells = [f"{a.mean():.2f} ± {a.std(ddof=1):.2f}" for a in auc]
        first = [title, f"{one['misfit']:.2f}", f"{one['met'][1]} of {one['of']}"]
        rows.append([*first, *cells])
    return markdown_table(heads, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description="Search twins with single parts off.")
    parser.add_argument("cell", type=Path, help="The file cell.yaml of studies.phoxi_twin.")
    parser.add_argument("--out", type=Path, required=True, help="The JSON file of the results.")
    parser.add_argument("--trials", type=int, default=200, help="Simulations of each search.")
    parser.add_argument("--draws", type=int, default=3, help="Draws of noise for the classifier.")
    options = parser.parse_args()
    bench = open_bench(resolve_cell(load_config(options.cell), options.cell.parent))
    results: dict[str, dict[str, Any]] = {}
    titles: dict[str, list[str]] = {"nothing": []} | {key: [key] for key in KNOBS}
    for title, off in titles.items():
        results[title] = search_without(bench, off, trials=options.trials, draws=options.draws)
        options.out.write_text(json.dumps(results, indent=1), encoding="utf-8")
        print(table_of({title: results[title]}).splitlines()[-1], flush=True)
    print(table_of(results))


if __name__ == "__main__":
    main()
