"""Success and balance of drops of typical parts, for the table of docs/measurements/drop.md.

Parts of each family of `ZOO` are dropped into one bin; their number is limited by the bin's volume.
A layout counts as made if `drop` returns it with the default limits of a configuration. It is in
balance if no point of a part moves by more than 1 mm in 1 s of simulation by MuJoCo.
"""

import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np

from graycast.base.errors import DropError
from graycast.rig.pair import preset_rig
from graycast.world.drop import DropLimits, drop, make_bodies
from graycast.world.drop.body import Body
from graycast.world.parts import Part
from graycast.world.scene import Bin, Scene

from .balance import unbalanced_m
from .figures import Figures, Show
from .zoo_parts import ZOO, zoo_part

BIN_M = (0.4, 0.3, 0.15)
BALANCED_M = 1e-3
FILL = 0.25  # share of the bin's volume that the bounding boxes of parts may fill
ENTANGLED = ("spring", "chain")  # At most ten are dropped, because a heap of these is one tangle.
ENTANGLED_MOST = 10


def measure(
    *,
    families: Sequence[str] = ZOO,
    counts: Sequence[int],
    seeds: int,
    hull_folder: Path | None = None,
    show: Show,
) -> Figures:
    """Return a row for each family and count: number, time and balance of its layouts.

    Each row is printed when it is complete.

    Args:
        families: names in `ZOO`.
        counts: numbers of parts, each reduced to the number for which the bin has room.
        seeds: number of drops per row.
        hull_folder: the folder of stored collision hulls.

    Raises:
        ValueError: there is no such family.
    """
    rows = []
    for part in [zoo_part(name) for name in families]:
        show(f"{part.name}: collision hulls")
        (body,) = make_bodies((part,), hull_folder=hull_folder)
        for count in dict.fromkeys(min(count, _most(part)) for count in counts):
            drops = []
            for seed in range(seeds):
                show(f"{part.name}: {count} of them, drop {seed + 1} of {seeds}")
                drops.append(_drop(part, body, count, seed, hull_folder))
            rows.append(_row(part.name, count, drops))
            print(describe_row(rows[-1]), flush=True)
    return {"seeds": seeds, "bin_m": list(BIN_M), "rows": rows}


def describe_row(row: Figures) -> str:
    """Return a row as one line of text."""
    text = f"{row['family']} x {row['count']}: {row['made']} of {row['asked']} made"
    if "attempts" in row:
        text += f", attempts {row['attempts']:g} (most {row['most']})"
    text += f", {row['cpu_s']:.2f} s (most {row['cpu_most_s']:.2f})"
    if "balanced" in row:
        text += f", {row['balanced']} in balance (moved by {row['moved_most_mm']:.2f} mm at most)"
    return text


def _most(part: Part) -> int:
    most = int(FILL * np.prod(BIN_M) / np.prod(part.mesh.extent_m))
    return max(1, min(most, ENTANGLED_MOST) if part.name in ENTANGLED else most)


def _drop(part: Part, body: Body, count: int, seed: int, hull_folder: Path | None) -> Figures:
    """Drop once; return the processor time and, if there is a layout, its properties."""
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
    finished = [figures for figures in drops if "attempts" in figures]
    seconds = [figures["cpu_s"] for figures in drops]
    row: Figures = {"family": family, "count": count, "made": len(finished), "asked": len(drops)}
    if finished:
        attempts = [figures["attempts"] for figures in finished]
        row |= {
            "attempts": median(attempts),
            "most": max(attempts),
            "overlap_mm": max(figures["overlap_mm"] for figures in finished),
        }
    row |= {"cpu_s": median(seconds), "cpu_most_s": max(seconds)}
    moved_mm = [figures["moved_mm"] for figures in finished if "moved_mm" in figures]
    if moved_mm:
        row |= {
            "balanced": sum(moved <= 1e3 * BALANCED_M for moved in moved_mm),
            "moved_median_mm": median(moved_mm),
            "moved_most_mm": max(moved_mm),
        }
    return row
