"""One scene all the way from parts to files, and many scenes on one or several processes.

A scene depends on (configuration, dataset seed, scene id) alone, not on the number of workers, the
order of scenes or a restart.
"""

import atexit
import multiprocessing
import os
import platform
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
from jaxtyping import UInt8

from . import __version__
from .config import (
    Config,
    file_digests,
    resolve_bin,
    resolve_environment,
    resolve_lamps,
    resolve_limits,
    resolve_parts,
    resolve_quality,
    resolve_scanner,
)
from .dataset import Sample, depth_scale_mm, described_values, open_store, write_scene
from .decode import CodeMap, Reason
from .drop import drop
from .errors import GraycastError
from .pattern import Code
from .picture import color_picture, gray_picture
from .render import OnFrame, Renderer, Rendering, choose_device, open_renderer
from .rig import grey_levels, place, standoff_m
from .scanner import Scanner, measure, take
from .scene import Scene
from .sensor import Capture


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A configuration with its files read: what all scenes of a dataset share.

    `scene` holds every kind of part; a scene drops one kind of it, or all where `config.mix`.
    """

    config: Config
    scene: Scene
    scanner: Scanner
    notes: tuple[str, ...]
    file_digests: dict[str, str]

    @property
    def code(self) -> Code:
        """The code that the scanner shows."""
        return self.scanner.patterns()

    def patterns(self) -> UInt8[np.ndarray, "n ph pw"]:
        """What the projector is given: grey levels that undo its response."""
        return self.code.render(lambda share: grey_levels(self.scanner.rig, share))


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One finished scene with what lies between radiance and sample, for pictures of it."""

    sample: Sample
    rendering: Rendering
    capture: Capture
    codes: CodeMap


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


def resolve_cell(config: Config, folder: Path) -> Cell:
    """Read what a configuration names; `folder` is where its relative paths start.

    Raises:
        GraycastError, ValueError: a file or a value that cannot be used, named.
    """
    parts, notes = resolve_parts(config, folder)
    scanner = resolve_scanner(config, folder)
    rig = scanner.rig
    box = resolve_bin(config.bin, folder)
    view = config.view
    target = view.target_m or (0.0, 0.0, box.inner_m[2] / 3)
    T_world_cam = place(
        rig,
        target_m=np.array(target),
        distance_m=view.distance_m or standoff_m(rig),
        tilt_rad=np.radians(view.tilt_deg),
        azimuth_rad=np.radians(view.azimuth_deg),
    )
    scene = Scene(
        rig=rig,
        T_world_cam=T_world_cam,
        parts=parts,
        bin=box,
        environment=resolve_environment(config.light.environment, folder),
        lamps=resolve_lamps(config.light),
    )
    return Cell(
        config=config,
        scene=scene,
        scanner=scanner,
        notes=notes,
        file_digests=file_digests(config, folder),
    )


# --- one scene ---------------------------------------------------------------------------------


def open_cell_renderer(
    cell: Cell,
    *,
    device: str = "auto",
    threads: int | None = None,
    on_frame: OnFrame | None = None,
) -> Renderer:
    """The renderer that a cell's configuration asks for; arguments as of `open_renderer`."""
    render = cell.config.render
    return open_renderer(
        render.backend,
        device=device,
        threads=threads,
        patterns_per_render=render.cycles.patterns_per_render,
        on_frame=on_frame,
    )


def make_scene(cell: Cell, scene_id: int, *, seed: int, renderer: Renderer) -> Shot:
    """One scene from its seeds to its sample.

    Raises:
        DropError: the parts did not come to an acceptable rest.
        ValueError: the picture is dark, or a value is out of its range.
    """
    config = cell.config
    # One independent stream per stage, so that a change in one leaves the others as they were.
    stream = np.random.SeedSequence(seed, spawn_key=(scene_id,)).generate_state(5, np.uint64)
    seeds = dict(
        zip(("counts", "drop", "render", "noise", "picture"), map(int, stream), strict=True)
    )
    timings: dict[str, float] = {}
    with _timed(timings, "drop"):
        counts = _counts(cell, scene_id, np.random.default_rng(seeds["counts"]))
        layout = drop(cell.scene, counts, seed=seeds["drop"], limits=resolve_limits(config))
    with _timed(timings, "render"):
        quality = resolve_quality(config)
        rendering = renderer.render(
            cell.scene, layout, cell.patterns(), quality=quality, seed=seeds["render"]
        )
    with _timed(timings, "sensor"):
        capture = take(cell.scanner, rendering.radiance, seed=seeds["noise"])
    with _timed(timings, "picture"):
        noisy = config.render.denoise and quality.denoise == "none"
        rgb = color_picture(
            cell.scanner,
            rendering,
            denoiser=renderer.denoiser if noisy else None,
            seed=seeds["picture"],
        )
    with _timed(timings, "decode"):
        codes, depth = measure(cell.scanner, capture)
    manifest = {
        "scene_id": scene_id,
        "dataset_seed": seed,
        "seeds": seeds,
        "backend": renderer.name,
        "device": renderer.device,
        "versions": _versions(renderer),
        "counts": {p.name: n for p, n in zip(cell.scene.parts, counts, strict=True) if n},
        "physics": {
            key: value
            for key, value in asdict(layout).items()
            if key not in ("T_world_part", "part_index")
        },
        "exposure_s": float(np.max(capture.exposure_s)),
        "reasons": {r.name.lower(): float((depth.reason == r).mean()) for r in Reason},
        "config": config.model_dump(mode="json", exclude={"scenes", "seed"}),
        "timings": timings,
    }
    sample = Sample(
        scene=cell.scene,
        layout=layout,
        truth=rendering.truth,
        rgb=rgb,
        gray=gray_picture(capture),
        scanner=depth,
        modulation=codes.modulation,
        manifest=manifest,
    )
    return Shot(sample=sample, rendering=rendering, capture=capture, codes=codes)


def _counts(cell: Cell, scene_id: int, rng: np.random.Generator) -> tuple[int, ...]:
    """How many of each kind: one kind in turn, or all kinds drawn at random."""
    low, high = cell.config.count_range
    total = int(rng.integers(low, high + 1))
    kinds = len(cell.scene.parts)
    if cell.config.mix:
        return tuple(int(n) for n in rng.multinomial(total, np.full(kinds, 1 / kinds)))
    return tuple(total if kind == scene_id % kinds else 0 for kind in range(kinds))


@contextmanager
def _timed(timings: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    timings[stage] = time.perf_counter() - start


def _versions(renderer: Renderer) -> dict[str, str]:
    packages = ("numpy", "rapier3d", "coacd", "numba", "pyoidn")
    return {
        "graycast": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        **renderer.versions,
    }


# --- many scenes -------------------------------------------------------------------------------


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
