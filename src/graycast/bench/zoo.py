"""A study of whether each family of parts comes to rest and is in balance, one drop per seed.

Each family of `ZOO` is dropped into one bin, as many parts as asked for or as many as it holds
loosely. A layout counts as made where `drop` returns it with the limits that a configuration has
by default, and as in balance where MuJoCo finds no point of a part moved by more than 1 mm in 1 s.
"""

import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np

from .. import __version__
from ..drop import DropLimits, convex_hulls, drop
from ..drop.body import Body, body_of
from ..errors import DropError
from ..parts import Part
from ..rig import preset_rig
from ..scene import Bin, Scene
from .balance import unbalanced_m
from .figures import Figures, stamped
from .kept import kept_rows, write_figures
from .zoo_parts import ZOO, zoo_part

STUDY = "zoo"  # its name, and that of its rows among the figures
BIN_M = (0.4, 0.3, 0.15)
BALANCED_M = 1e-3
FILL = 0.25  # share of the bin's room that the boxes about the parts may take
ENTANGLED = ("spring", "chain")  # dropped in tens at most: a heap of them is one tangle
ENTANGLED_MOST = 10


def study_zoo(
    *,
    families: Sequence[str] = ZOO,
    counts: Sequence[int] = (1, 10, 60),
    seeds: int = 20,
    hull_folder: Path | None = None,
    file: Path | None = None,
    on_work: Callable[[float, str], None] = lambda share, what: None,
    on_row: Callable[[Figures], None] = lambda row: None,
) -> Figures:
    """A row for each family and count: how many layouts were made, how fast, and how they hold.

    The first count is dropped of all families, then the next: so what a larger count takes does not
    keep the others waiting.

    Args:
        families: which of `ZOO` are dropped.
        counts: numbers of parts; a family of which the bin holds fewer is dropped in that number.
        seeds: drops a row.
        hull_folder: where collision hulls are kept.
        file: where the figures are written after each drop. What an earlier study with the same
            settings has left there is taken from it.
        on_work: called with the share of completed work and the name of the next step.
        on_row: called with each completed row.

    Raises:
        ValueError: no such family.
        GraycastError: the file holds something else, or cannot be written.
    """
    parts = [zoo_part(name) for name in dict.fromkeys(families)]
    settings = {
        "graycast": __version__,
        "families": [part.name for part in parts],
        "counts": list(counts),
        "seeds": seeds,
        "bin_m": list(BIN_M),
        "mujoco": version("mujoco") if find_spec("mujoco") else "not installed: no balance",
    }
    rows: dict[tuple[str, int], Figures] = {}
    if file is not None:
        rows |= {_place(row): row for row in kept_rows(file, STUDY, settings)}

    def keep(row: Figures) -> None:
        rows[_place(row)] = row
        if file is not None:
            write_figures(file, stamped(STUDY, _figures(settings, rows)))

    if file is not None:
        write_figures(file, stamped(STUDY, _figures(settings, rows)))  # else it fails after hours
    jobs = dict.fromkeys((part.name, min(count, _most(part))) for count in counts for part in parts)
    named = {part.name: part for part in parts}
    for i, (name, count) in enumerate(jobs):
        row = rows.get((name, count), {"asked": 0, "drops": []})
        if row["asked"] < seeds:
            on_work(i / len(jobs), f"{name}: collision hulls")
            body = body_of(named[name], convex_hulls(named[name].mesh, folder=hull_folder).hulls)
            drops = row["drops"]
            for seed in range(len(drops), seeds):
                what = f"{name}: {count} of them, drop {seed + 1} of {seeds}"
                on_work((i + seed / seeds) / len(jobs), what)
                drops = [*drops, _drop(named[name], body, count, seed, hull_folder)]
                row = _row(name, count, drops)
                keep(row if len(drops) == seeds else row | {"drops": drops})
        on_row(row)
    on_work(1.0, "all dropped")
    return _figures(settings, rows)


def describe_row(row: Figures) -> str:
    """A row in one line."""
    text = f"{row['family']} x {row['count']}: {row['made']} of {row['asked']} made"
    if "attempts" in row:
        text += f", attempts {row['attempts']:g} (most {row['most']})"
    text += f", {row['cpu_s']:.2f} s (most {row['cpu_most_s']:.2f})"
    if "balanced" in row:
        text += f", {row['balanced']} in balance (moved by {row['moved_most_mm']:.2f} mm at most)"
    return text


def _place(row: Figures) -> tuple[str, int]:
    return row["family"], row["count"]


def _figures(settings: Figures, rows: dict[tuple[str, int], Figures]) -> Figures:
    """The table by family and count; a row that is not finished has its drops with it."""
    number = {name: i for i, name in enumerate(settings["families"])}
    table = [rows[place] for place in sorted(rows, key=lambda place: (number[place[0]], place[1]))]
    finished = [row for row in table if row["asked"] == settings["seeds"]]
    met = sum(row["made"] >= 0.95 * row["asked"] for row in finished)
    return settings | {"rows": len(finished), "rows_with_19_of_20_made": met, STUDY: table}


def _most(part: Part) -> int:
    most = int(FILL * np.prod(BIN_M) / np.prod(part.mesh.extent_m))
    return max(1, min(most, ENTANGLED_MOST) if part.name in ENTANGLED else most)


def _drop(part: Part, body: Body, count: int, seed: int, hull_folder: Path | None) -> Figures:
    """One drop: processor time, and, where it made a layout, how that is."""
    box = Bin(inner_m=BIN_M)
    scene = Scene(rig=preset_rig("paper"), T_world_cam=np.eye(4), parts=(part,), bin=box)
    start = time.process_time()
    try:
        layout = drop(scene, (count,), seed=seed, limits=DropLimits(), hull_folder=hull_folder)
    except DropError:
        return {"cpu_s": time.process_time() - start}
    figures = {
        "cpu_s": time.process_time() - start,
        "attempts": layout.attempt + 1,
        "overlap_mm": 1e3 * layout.deepest_penetration_m,
    }
    if find_spec("mujoco"):
        figures["moved_mm"] = 1e3 * float(unbalanced_m(box, (body,), layout).max())
    return figures


def _row(family: str, count: int, drops: list[Figures]) -> Figures:
    made = [figures for figures in drops if "attempts" in figures]
    seconds = [figures["cpu_s"] for figures in drops]
    row: Figures = {"family": family, "count": count, "made": len(made), "asked": len(drops)}
    if made:
        attempts = [figures["attempts"] for figures in made]
        row |= {
            "attempts": median(attempts),
            "most": max(attempts),
            "overlap_mm": max(figures["overlap_mm"] for figures in made),
        }
    row |= {"cpu_s": median(seconds), "cpu_most_s": max(seconds)}
    moved_mm = [figures["moved_mm"] for figures in made if "moved_mm" in figures]
    if moved_mm:
        row |= {
            "balanced": sum(moved <= 1e3 * BALANCED_M for moved in moved_mm),
            "moved_median_mm": median(moved_mm),
            "moved_most_mm": max(moved_mm),
        }
    return row
