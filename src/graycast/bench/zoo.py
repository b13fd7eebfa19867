"""Does every family of parts come to rest, and is what rests in balance? One drop a seed.

Each family of `ZOO` is dropped into one bin, as many parts as asked for or as many as it holds
loosely. A layout counts as made where `drop` returns it with the limits that a configuration has
by default, and as in balance where MuJoCo finds no point of a part moved by more than 1 mm in 1 s.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
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
from ..rig import preset
from ..scene import Bin, Layout, Scene
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
        file: where the figures are written after each row. Rows that an earlier study with the same
            settings has left there are taken from it.
        on_work: is told the share of the work that is done, and what comes next.
        on_row: is told each row when it is there.

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
    kept = [] if file is None else kept_rows(file, STUDY, settings)
    figures = _figures(settings, kept)
    if file is not None:
        write_figures(file, stamped(STUDY, figures))  # a path that cannot be written fails now
    for row in kept:
        on_row(row)
    done = {(row["family"], row["count"]) for row in kept}
    jobs = dict.fromkeys((part.name, min(count, _most(part))) for count in counts for part in parts)
    named = {part.name: part for part in parts}
    for i, (name, count) in enumerate(jobs):
        if (name, count) in done:
            continue
        part, share = named[name], i / len(jobs)
        on_work(share, f"{name}: collision hulls")
        body = body_of(part, convex_hulls(part.mesh, folder=hull_folder).hulls)
        told = partial(_tell, on_work, share, f"{name}: {count} of them")
        row = _row(part, body, count, seeds, hull_folder, told)
        figures = _figures(settings, [*figures[STUDY], row])
        if file is not None:
            write_figures(file, stamped(STUDY, figures))
        on_row(row)
    on_work(1.0, "all dropped")
    return figures


def describe_row(row: Figures) -> str:
    """A row in one line."""
    text = f"{row['family']} x {row['count']}: {row['made']} of {row['asked']} made"
    if "attempts" in row:
        text += f", attempts {row['attempts']:g} (most {row['most']})"
    text += f", {row['cpu_s']:.2f} s (most {row['cpu_most_s']:.2f})"
    if "balanced" in row:
        text += f", {row['balanced']} in balance (moved by {row['moved_most_mm']:.2f} mm at most)"
    return text


def _figures(settings: Figures, rows: list[Figures]) -> Figures:
    place = {name: i for i, name in enumerate(settings["families"])}
    rows = sorted(rows, key=lambda row: (place[row["family"]], row["count"]))
    met = sum(row["made"] >= 0.95 * row["asked"] for row in rows)
    return settings | {"rows": len(rows), "rows_with_19_of_20_made": met, STUDY: rows}


def _tell(on_work: Callable[[float, str], None], share: float, what: str, more: str) -> None:
    on_work(share, f"{what}, {more}")


def _most(part: Part) -> int:
    most = int(FILL * np.prod(BIN_M) / np.prod(part.mesh.extent_m))
    return max(1, min(most, ENTANGLED_MOST) if part.name in ENTANGLED else most)


def _row(
    part: Part,
    body: Body,
    count: int,
    seeds: int,
    hull_folder: Path | None,
    on_step: Callable[[str], None],
) -> Figures:
    box = Bin(inner_m=BIN_M)
    scene = Scene(rig=preset("paper"), T_world_cam=np.eye(4), parts=(part,), bin=box)
    made: list[Layout] = []
    seconds = []
    for seed in range(seeds):
        on_step(f"drop {seed + 1} of {seeds}")
        start = time.process_time()
        try:
            made.append(
                drop(scene, (count,), seed=seed, limits=DropLimits(), hull_folder=hull_folder)
            )
        except DropError:
            continue
        finally:
            seconds.append(time.process_time() - start)
    row: Figures = {"family": part.name, "count": count, "made": len(made), "asked": seeds}
    if made:
        row |= {
            "attempts": median(layout.attempt + 1 for layout in made),
            "most": max(layout.attempt + 1 for layout in made),
            "overlap_mm": 1e3 * max(layout.deepest_penetration_m for layout in made),
        }
    row |= {"cpu_s": median(seconds), "cpu_most_s": max(seconds)}
    if made and find_spec("mujoco"):
        moved_m = []
        for layout in made:
            on_step(f"balance {len(moved_m) + 1} of {len(made)}")
            moved_m.append(float(unbalanced_m(box, (body,), layout).max()))
        row |= {
            "balanced": sum(moved <= BALANCED_M for moved in moved_m),
            "moved_median_mm": 1e3 * median(moved_m),
            "moved_most_mm": 1e3 * max(moved_m),
        }
    return row
