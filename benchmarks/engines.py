"""Overhead of worker processes and Ray over a plain loop, for docs/how-to/many-scenes.md."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from importlib.util import find_spec
from statistics import median

from graycast.cell.engine import (
    Failed,
    Pool,
    SceneMaker,
    SceneTask,
    TaskResult,
    Workers,
    make_all,
    open_pool,
)
from graycast.cell.generate import depth_step_mm

from .figures import Figures, Show
from .stages import PARTS, cell_of

SCENES = 6  # number of scenes in each round
ROUNDS = 3


@dataclass
class _Contender:
    """A function that makes scenes with one engine, and the times of its rounds."""

    make: Callable[[list[int]], None]
    seconds: list[float] = field(default_factory=list)


def measure(*, count: int = PARTS, scenes: int = SCENES, show: Show) -> Figures:
    """Time the same scenes with each engine in turn, after a warm-up, with one thread per worker.

    Files are made but not written. `overhead` is the time relative to the bare loop, minus one.
    `speedup` is the time of one worker divided by that of two. Both are medians of ratios within
    rounds, so that slow periods of the machine affect both sides.

    Raises:
        DropError, GraycastError: a scene could not be made.
    """
    cell = cell_of({"count": count})
    task = SceneTask(cell=cell, seed=0, device="cpu", depth_scale_mm=depth_step_mm(cell))
    with ExitStack() as open_now:
        contenders = dict(_contenders(task, open_now))
        for name, contender in contenders.items():
            show(f"warm-up of {name}")
            contender.make([0, 1])
        for round_number in range(ROUNDS):
            first = 2 + round_number * scenes
            for name, contender in contenders.items():
                show(f"round {round_number + 1}, {name}")
                start = time.perf_counter()
                contender.make(list(range(first, first + scenes)))
                contender.seconds.append(time.perf_counter() - start)
    return _figures(contenders, count, scenes)


def _contenders(task: SceneTask, open_now: ExitStack) -> Iterator[tuple[str, _Contender]]:
    maker = open_now.enter_context(closing(SceneMaker(task, threads=1)))

    def bare(scene_ids: list[int]) -> None:
        for scene_id in scene_ids:
            maker.make(scene_id)

    yield "bare", _Contender(bare)
    engines = ["local"] + (["ray"] if find_spec("ray") else [])
    for engine in engines:
        pool = open_pool(task, Workers(engine=engine, count=2, threads=1), scenes=2)
        open_now.enter_context(closing(pool))
        for workers in (2, 1):
            yield f"{engine}_{workers}", _Contender(_all_by(_Narrowed(pool, workers)))


class _Narrowed:
    """A pool that accepts at most `limit` scenes at a time."""

    def __init__(self, pool: Pool, limit: int) -> None:
        self._pool, self._limit, self._running = pool, limit, 0

    @property
    def free(self) -> int:
        return min(self._pool.free, self._limit - self._running)

    def submit(self, scene_id: int) -> None:
        self._running += 1
        self._pool.submit(scene_id)

    def gather(self) -> TaskResult | Failed:
        self._running -= 1
        return self._pool.gather()

    def close(self) -> None:
        pass  # `measure` closes the pool, which several contenders share.


def _all_by(pool: Pool) -> Callable[[list[int]], None]:
    def make(scene_ids: list[int]) -> None:
        for outcome in make_all(pool, scene_ids):
            if not isinstance(outcome, TaskResult):
                raise outcome.error

    return make


def _figures(contenders: dict[str, _Contender], count: int, scenes: int) -> Figures:
    def over(name: str, base: str) -> float:
        pairs = zip(contenders[name].seconds, contenders[base].seconds, strict=True)
        return median(a / b for a, b in pairs)

    figures: Figures = {
        "parts": count,
        "scenes": scenes,
        "cores": len(os.sched_getaffinity(0)),
        "seconds": {name: median(c.seconds) for name, c in contenders.items()},
    }
    for engine in ("local", "ray"):
        if f"{engine}_1" in contenders:
            figures[f"{engine}_overhead"] = over(f"{engine}_1", "bare") - 1
            figures[f"{engine}_speedup"] = over(f"{engine}_1", f"{engine}_2")
    return figures
