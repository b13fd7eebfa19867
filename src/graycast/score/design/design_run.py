"""Scan a study's heaps with all its settings in worker processes."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from ...base.progress import UNWATCHED, ProgressMeter
from ...base.streams import scene_seeds
from ...base.usage import rss_bytes
from ...camera.picture import gray_picture
from ...camera.scanner import measure, scan_seconds, take
from ...cell.config import resolve_quality
from ...cell.engine import ALONE, Failed, Job, TaskResult, WorkerRenderer, Workers, make_missing
from ...cell.metering import metered_region
from ...cell.resolve import Cell
from ...cell.simulate import counts_of
from ...rendering import Rendering
from ...world.drop import drop
from ...world.parts import Part
from ...world.scene import Layout
from .heap_surface import HeapSurface, spread_surface
from .point_fates import figures, judge, picture_png, view_of
from .result_files import claim_setting, heap_files, is_finished, open_design, write_heap
from .setting import Placed, lights_of, place_settings, settings_of
from .study import DesignSpec


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Heap:
    """A heap of dropped parts, and the seeds for light and noise, which all settings share."""

    layout: Layout
    surface: HeapSurface
    render_seed: int
    noise_seed: int


def make_heap(cell: Cell, spec: DesignSpec, number: int, *, progress: ProgressMeter) -> Heap:
    """Return heap `number`; it equals the scene with this number in a dataset of the same seed.

    Raises:
        DropError, ValueError: the parts do not come to rest, or do not fit into the bin.
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


class Comparer:
    """A worker that scans a study's heaps; it keeps its renderer and the current heaps."""

    def __init__(self, task: "DesignTask", *, threads: int | None, progress: ProgressMeter) -> None:
        self._task, self._progress = task, progress
        self._renderers = WorkerRenderer(device=task.device, threads=threads, progress=progress)
        self._heaps: dict[tuple[str | None, int], Heap] = {}

    def make(self, scene_id: int) -> TaskResult:
        """Scan one heap with all settings of one light: render once, then scan for each setting.

        Raises:
            DropError, ValueError: this heap cannot be made or rendered; other heaps may succeed.
        """
        start = time.perf_counter()
        group, number = self._task.group(scene_id)
        heap, scene = self._heap(group[0], number), group[0].cell.scene
        rendering, own = self._light(group, heap)
        view = view_of(scene, heap.layout, heap.surface)
        files: list[tuple[str, bytes]] = []
        measured = {}
        for placed, patterns in zip(group, own, strict=True):
            scanner, name = placed.cell.scanner, placed.setting.name
            radiance = replace(rendering.radiance, pattern=rendering.radiance.pattern[patterns])
            metered = metered_region(scene, scanner.exposure)
            capture = take(scanner, radiance, seed=heap.noise_seed, metered=metered)
            _, depth = measure(scanner, capture, path_noise=radiance.path_noise)
            fates = judge(
                view, heap.surface, rendering.truth, depth, wrong_m=self._task.spec.wrong_m
            )
            seconds = scan_seconds(capture, readout_s=self._task.spec.readout_s)
            record = figures(scene, view, heap.surface, fates, seconds=seconds)
            measured[name] = record["measured"]
            picture = None
            if number == 0:
                picture = picture_png(gray_picture(capture), view, heap.surface, fates)
            files += heap_files(name, number, record, picture)
        return TaskResult(
            scene_id=scene_id,
            files=tuple(files),
            seconds=time.perf_counter() - start,
            reasons=measured,
            rss_bytes=rss_bytes(),
        )

    def _heap(self, placed: Placed, number: int) -> Heap:
        """Return the heap for a setting's bin; settings with the same bin share it."""
        key = placed.setting.bin, number
        if key not in self._heaps:
            self._heaps = {other: heap for other, heap in self._heaps.items() if other[1] == number}
            self._heaps[key] = make_heap(
                placed.cell, self._task.spec, number, progress=self._progress
            )
        return self._heaps[key]

    def _light(self, group: tuple[Placed, ...], heap: Heap) -> tuple[Rendering, list[slice]]:
        """Render the patterns of all codes; also return the slice of patterns for each setting."""
        cell = group[0].cell
        by_code = {placed.cell.scanner.code: placed.cell.patterns() for placed in group}
        ends = np.cumsum([len(patterns) for patterns in by_code.values()]).tolist()
        own = {
            code: slice(end - len(patterns), end)
            for (code, patterns), end in zip(by_code.items(), ends, strict=True)
        }
        self._progress.stage(f"{cell.config.render.backend} renders {group[0].setting.lit.name}")
        with self._renderers.of(cell.config.render) as renderer:
            rendering = renderer.render(
                cell.scene,
                heap.layout,
                np.concatenate(list(by_code.values())),
                quality=resolve_quality(cell.config),
                seed=heap.render_seed,
            )
        return rendering, [own[placed.cell.scanner.code] for placed in group]

    def close(self) -> None:
        self._renderers.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignTask(Job):
    """The data that a worker needs; with n lights, scene k is heap `k // n` under light `k % n`.

    Scenes are ordered by heap. Hence a worker keeps only the heaps of one number, and a stopped
    study has some results for every setting.
    """

    RUNNER = Comparer

    spec: DesignSpec
    lights: tuple[tuple[Placed, ...], ...]

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.lights[0][0].cell.scene.parts

    def group(self, scene_id: int) -> tuple[tuple[Placed, ...], int]:
        """Return the settings of a scene, which share one light, and the number of its heap."""
        layout, light = divmod(scene_id, len(self.lights))
        return self.lights[light], layout

    def name(self, scene_id: int) -> tuple[str, int]:
        """Return the name of a scene's setting (or of its light), and the number of its heap."""
        group, layout = self.group(scene_id)
        setting = group[0].setting
        return setting.name if len(group) == 1 else setting.lit.name, layout


def run_design(
    spec: DesignSpec,
    out: Path,
    *,
    device: str = "auto",
    workers: Workers = ALONE,
    on_result: Callable[[str, int, TaskResult], None] = lambda name, layout, result: None,
    on_failed: Callable[[str, int, Failed], None] = lambda name, layout, failed: None,
    progress: ProgressMeter = UNWATCHED,
) -> tuple[str, ...]:
    """Scan all heaps with all settings, except those that are finished.

    Args:
        out: folder of the study; a study can be resumed there, even with more settings or heaps.
        device: device of the renderer.
        on_result, on_failed: functions that receive the name and heap from `DesignTask.name`.

    Returns:
        Names and heaps of the renderings that failed, as `NAME/HEAP`.

    Raises:
        ConfigError: none of the settings can be used.
        DatasetError: the folder is in use, or its figures come from other values.
        DeviceError: this machine has no such device.
        GraycastError, ValueError: all scans failed; the error is that of one of them.
    """
    placed = place_settings(spec, settings_of(spec), progress=progress)
    task = DesignTask(
        spec=spec,
        lights=lights_of(placed),
        seed=spec.seed,
        device=workers.device(placed[0].cell.config.render.backend, device),
    )

    def is_missing(scene_id: int) -> bool:
        group, layout = task.group(scene_id)
        return not all(is_finished(out, one.setting.name, layout) for one in group)

    def keep(result: TaskResult) -> None:
        write_heap(out, result.files)
        on_result(*task.name(result.scene_id), result)

    with open_design(out):
        for one in placed:
            claim_setting(out, one, one.described(spec))
        scene_ids = range(len(task.lights) * spec.layouts)
        lost = make_missing(
            task,
            list(filter(is_missing, scene_ids)),
            what="scans",
            total=len(scene_ids),
            workers=workers,
            progress=progress,
            on_result=keep,
            on_failed=lambda failed: on_failed(*task.name(failed.scene_id), failed),
        )
    return tuple("{}/{:03d}".format(*task.name(heap.scene_id)) for heap in lost)
