"""A heap of parts, dropped once for all settings of a bin, with its surface points."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ...base.progress import ProgressMeter
from ...base.streams import scene_seeds
from ...cell.resolve import Cell
from ...cell.simulate import counts_of
from ...world.drop import drop
from ...world.scene import Layout
from .heap_surface import HeapSurface, spread_surface
from .study import DesignSpec


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Heap:
    """Parts as they lie, and the seeds of the light and the noise that all settings share."""

    layout: Layout
    surface: HeapSurface
    render_seed: int
    noise_seed: int


def make_heap(cell: Cell, spec: DesignSpec, number: int, *, progress: ProgressMeter) -> Heap:
    """The heap of that number, as a dataset of the same seed has it in its scene.

    Raises:
        DropError, ValueError: the parts found no rest, or do not fit the bin.
    """
    seeds = scene_seeds(spec.seed, number, domain=False)
    layout = drop(
        cell.scene,
        counts_of(cell, number, np.random.default_rng(seeds["counts"])),
        seed=seeds["drop"],
        limits=cell.config.drop,
        progress=progress,
    )
    return Heap(
        layout=layout,
        surface=spread_surface(cell.scene, layout, points=spec.points, cone_deg=spec.cone_deg),
        render_seed=seeds["render"],
        noise_seed=seeds["noise"],
    )
