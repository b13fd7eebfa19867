"""Many scenes of one cell into a dataset's folder, on one or several processes.

A scene depends on (configuration, dataset seed, scene id) alone, not on the number of workers, the
order of scenes or a restart.
"""

import atexit
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np

from .cell import Cell, open_cell_renderer
from .dataset import depth_scale_mm, described_values, open_store, write_scene
from .decode import Reason
from .errors import GraycastError
from .render import OnFrame, Renderer, choose_device
from .scanner import Scanner
from .simulate import make_scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """A scene has ended: its id, seconds it took and share of pixels per reason."""

    scene_id: int
    seconds: float
    reasons: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What a run did."""

    written: int
    found: int
    seconds: float
    reasons: dict[str, float]


def generate(
    cell: Cell,
    out: Path,
    *,
    scenes: int,
    seed: int,
    device: str,
    workers: int,
    on_start: Callable[[int], None],
    on_progress: Callable[[Progress], None],
    on_frame: OnFrame | None = None,
) -> Summary:
    """Make the scenes 0 .. scenes-1 that are not in `out` yet, and the split's COCO file.

    Args:
        out: the dataset's folder; made, or continued where the same configuration began it.
        device: 'auto', 'cpu', 'cuda' or, of Cycles, 'optix'.
        workers: processes; with more than one the cores are shared out among them.
        on_start: called with the number of scenes that are there already.
        on_progress: called in this process after each scene.
        on_frame: as of `open_renderer`, where one worker makes all.

    Raises:
        DatasetError: the folder is another dataset's, is in use, or the disk refuses.
        DeviceError: no such device here.
        DropError: parts that do not come to rest; scenes made so far are kept.
    """
    start = time.perf_counter()
    device = choose_device(cell.config.render.backend, device)
    scale_mm = depth_scale_mm(cell.scene.rig.far_m)
    identity = cell.config.model_dump(mode="json", exclude={"scenes", "seed"})
    with open_store(
        out,
        config=identity | {"files": cell.file_digests, "scanner": _identity(cell.scanner)},
        seed=seed,
        parts=cell.scene.parts,
        rig=cell.scene.rig,
        depth_scale_mm=scale_mm,
    ) as store:
        found = store.finished()
        todo = [scene_id for scene_id in range(scenes) if scene_id not in found]
        task = _Task(cell=cell, out=out, seed=seed, device=device, depth_scale_mm=scale_mm)
        on_start(scenes - len(todo))
        alone = workers == 1 or len(todo) <= 1
        run = _run_here(task, todo, on_frame) if alone else _run_on_processes(task, todo, workers)
        done = []
        try:
            with closing(run) as ended:
                for progress in ended:
                    done.append(progress)
                    on_progress(progress)
            store.finish(range(scenes))
        except BaseException:
            store.tidy()
            raise
    reasons = {
        reason.name.lower(): float(np.mean([p.reasons[reason.name.lower()] for p in done]))
        for reason in Reason
        if done
    }
    return Summary(
        written=len(done),
        found=scenes - len(todo),
        seconds=time.perf_counter() - start,
        reasons=reasons,
    )


def _identity(scanner: Scanner) -> dict[str, Any]:
    """What a preset or a rig file says beside its rig, which the store keeps itself."""
    names = ("code", "sensor", "exposure", "decode", "filters")
    return {name: described_values(getattr(scanner, name)) for name in names}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """What a worker needs to make any scene."""

    cell: Cell
    out: Path
    seed: int
    device: str
    depth_scale_mm: float


def _run_here(
    task: _Task, todo: list[int], on_frame: OnFrame | None
) -> Generator[Progress, None, None]:
    if not todo:
        return
    with open_cell_renderer(task.cell, device=task.device, on_frame=on_frame) as renderer:
        for scene_id in todo:
            yield _finish_scene(task, scene_id, renderer)


def _run_on_processes(
    task: _Task, todo: list[int], workers: int
) -> Generator[Progress, None, None]:
    threads = max(1, (os.cpu_count() or 1) // workers)
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(
        min(workers, len(todo)),
        mp_context=multiprocessing.get_context("spawn"),  # forked threads of a JIT do not live on
        initializer=_start_worker,
        initargs=(task, threads),
    )
    try:
        with _deaf_to_interrupts():
            waiting = {pool.submit(_finish_in_worker, task, scene_id) for scene_id in todo}
        while waiting:
            ended, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ended:
                yield future.result()
    except (KeyboardInterrupt, GeneratorExit):
        for worker in set(multiprocessing.active_children()) - set(others):
            worker.terminate()  # rather than wait for minutes; the next run removes what it left
        raise
    except BrokenProcessPool as error:
        raise GraycastError(
            "a worker process died (killed, or out of memory): use fewer --workers and run the "
            "same command again; finished scenes are kept"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes started inside do not hear Ctrl-C: their parent does, and ends them quietly."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signals
        return
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, heard)


_worker_renderer: Renderer | None = None  # of a worker process; a pool has no other place for it


def _start_worker(task: _Task, threads: int) -> None:
    global _worker_renderer
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    _worker_renderer = open_cell_renderer(task.cell, device=task.device, threads=threads)
    atexit.register(_worker_renderer.close)


def _finish_in_worker(task: _Task, scene_id: int) -> Progress:
    return _finish_scene(task, scene_id, _worker_renderer)


def _finish_scene(task: _Task, scene_id: int, renderer: Renderer) -> Progress:
    start = time.perf_counter()
    shot = make_scene(task.cell, scene_id, seed=task.seed, renderer=renderer)
    write_scene(task.out, scene_id, shot.sample, task.depth_scale_mm)
    return Progress(
        scene_id=scene_id,
        seconds=time.perf_counter() - start,
        reasons=dict(shot.sample.manifest["reasons"]),
    )
