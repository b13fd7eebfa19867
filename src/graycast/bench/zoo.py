"""Does every family of parts come to rest, and is what rests in balance? One drop a seed.

Each family of `ZOO` is dropped into one bin, as many parts as asked for or as many as it holds
loosely. A layout counts as made where `drop` returns it with the limits that a configuration has
by default, and as in balance where MuJoCo finds no point of a part moved by more than 1 mm in 1 s.
"""

import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np

from ..drop import DropLimits, convex_hulls, drop
from ..drop.body import Body, body_of
from ..errors import DropError
from ..parts import Part
from ..rig import preset
from ..scene import Bin, Layout, Scene
from .balance import unbalanced_m
from .figures import Figures
from .zoo_parts import ZOO, zoo_part

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
    on_work: Callable[[float, str], None] = lambda share, what: None,
) -> Figures:
    """A row for each family and count: how many layouts were made, how fast, and how they hold.

    Raises:
        ValueError: no such family.
    """
    rows = []
    for i, name in enumerate(families):
        part = zoo_part(name)
        on_work(i / len(families), f"{name}: collision hulls")
        body = body_of(part, convex_hulls(part.mesh, folder=hull_folder))
        for count in dict.fromkeys(min(count, _most(part)) for count in counts):
            on_work(i / len(families), f"{name}: {count} of them, {seeds} times")
            rows.append(_row(part, body, count, seeds, hull_folder))
    on_work(1.0, "all dropped")
    met = sum(row["made"] >= 0.95 * row["asked"] for row in rows)
    balance = {} if find_spec("mujoco") else {"balance": "not measured: mujoco is not installed"}
    return {
        "bin_m": list(BIN_M),
        "seeds": seeds,
        "rows": len(rows),
        "rows_with_19_of_20_made": met,
        **balance,
        "zoo": rows,
    }


def _most(part: Part) -> int:
    most = int(FILL * np.prod(BIN_M) / np.prod(part.mesh.extent_m))
    return max(1, min(most, ENTANGLED_MOST) if part.name in ENTANGLED else most)


def _row(part: Part, body: Body, count: int, seeds: int, hull_folder: Path | None) -> Figures:
    box = Bin(inner_m=BIN_M)
    scene = Scene(rig=preset("paper"), T_world_cam=np.eye(4), parts=(part,), bin=box)
    made: list[Layout] = []
    seconds = []
    for seed in range(seeds):
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
        moved_m = [float(unbalanced_m(box, (body,), layout).max()) for layout in made]
        row |= {
            "balanced": sum(moved <= BALANCED_M for moved in moved_m),
            "moved_median_mm": 1e3 * median(moved_m),
            "moved_most_mm": 1e3 * max(moved_m),
        }
    return row
