"""All settings of a study on all its heaps, by workers wherever they are."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...base.progress import UNWATCHED, ProgressMeter
from ...base.usage import rss_bytes
from ...camera.picture import gray_picture
from ...camera.scanner import measure, scan_seconds, take
from ...cell.config import resolve_quality
from ...cell.engine import ALONE, Failed, Job, TaskResult, WorkerRenderer, Workers, make_missing
from ...rendering import Rendering
from ...world.parts import Part
from .fate_picture import picture_png
from .heap import Heap, make_heap
from .point_fates import figures, judge, view_of
from .result_files import heap_files, open_design
from .setting import Placed, Setting, lights_of, place_settings, settings_of
from .study import DesignSpec


class Comparer:
    """Scans heaps of one study; the renderer and the heaps of each bin are kept."""

    def __init__(self, task: "DesignTask", *, threads: int | None, progress: ProgressMeter) -> None:
        self._task, self._progress = task, progress
        self._kept = WorkerRenderer(device=task.device, threads=threads, progress=progress)
        self._heaps: dict[tuple[str | None, int], Heap] = {}

    def make(self, scene_id: int) -> TaskResult:
        """One heap in one light, by all codes and exposures.

        Raises:
            DropError, ValueError: this heap cannot be made or lit; the next one may be.
        """
        start = time.perf_counter()
        group, number = self._task.named(scene_id)
        heap, scene = self._heap(group[0], number), group[0].cell.scene
        rendering, own = self._light(group, heap)
        view = view_of(scene, heap.layout, heap.surface)
        files: list[tuple[str, bytes]] = []
        measured = {}
        for placed, patterns in zip(group, own, strict=True):
            scanner, name = placed.cell.scanner, placed.setting.name
            radiance = replace(rendering.radiance, pattern=rendering.radiance.pattern[patterns])
            capture = take(scanner, radiance, seed=heap.noise_seed)
            _, depth = measure(scanner, capture)
            fates = judge(
                view, heap.surface, rendering.truth, depth, wrong_m=self._task.spec.wrong_m
            )
            seconds = scan_seconds(scanner, capture, readout_s=self._task.spec.readout_s)
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
        """The heap of a bin, dropped once for all settings that have this bin."""
        key = placed.setting.bin, number
        if key not in self._heaps:
            self._heaps = {other: heap for other, heap in self._heaps.items() if other[1] == number}
            self._heaps[key] = make_heap(
                placed.cell, self._task.spec, number, progress=self._progress
            )
        return self._heaps[key]

    def _light(self, group: tuple[Placed, ...], heap: Heap) -> tuple[Rendering, list[slice]]:
        """One rendering of the patterns of all codes, and where each setting's own are in it."""
        cell = group[0].cell
        by_code = {placed.cell.scanner.code: placed.cell.patterns() for placed in group}
        ends = np.cumsum([len(patterns) for patterns in by_code.values()]).tolist()
        own = {
            code: slice(end - len(patterns), end)
            for (code, patterns), end in zip(by_code.items(), ends, strict=True)
        }
        self._progress.stage(f"{cell.config.render.backend} renders {group[0].setting.lit.name}")
        with self._kept.of(cell.config.render) as renderer:
            rendering = renderer.render(
                cell.scene,
                heap.layout,
                np.concatenate(list(by_code.values())),
                quality=resolve_quality(cell.config),
                seed=heap.render_seed,
            )
        return rendering, [own[placed.cell.scanner.code] for placed in group]

    def close(self) -> None:
        self._kept.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignTask(Job):
    """What a worker needs to know: with n lights its scene k is heap `k // n` in light `k % n`.

    Heap by heap, so that a worker holds one of them and a stopped study has some of each setting.
    """

    RUNNER = Comparer

    spec: DesignSpec
    lights: tuple[tuple[Placed, ...], ...]

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.lights[0][0].cell.scene.parts

    def named(self, scene_id: int) -> tuple[tuple[Placed, ...], int]:
        """The settings of a scene, which share their light, and the number of its heap."""
        layout, light = divmod(scene_id, len(self.lights))
        return self.lights[light], layout


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
    """Scan what is not scanned yet.

    Args:
        out: the study's folder. The same study goes on in it, also with more settings or heaps.
        device: of the renderer.
        on_result, on_failed: take results with the name of a rendering, and the number of its heap.

    Returns:
        The renderings that could not be made, by name and heap.

    Raises:
        ConfigError: no setting makes a cell.
        DatasetError: the folder is in use, or its figures are of other values.
        DeviceError: no such device here.
        GraycastError, ValueError: nothing came out, for this reason.
    """
    placed = place_settings(spec, settings_of(spec), progress=progress)
    chosen = workers.device(placed[0].cell.config.render.backend, device)
    task = DesignTask(spec=spec, lights=lights_of(placed), seed=spec.seed, device=chosen)

    def named(scene_id: int) -> tuple[str, int]:
        group, layout = task.named(scene_id)
        return _light_name(group), layout

    def keep(result: TaskResult) -> None:
        folder.write(result.files)
        on_result(*named(result.scene_id), result)

    with open_design(out) as folder:
        for one in placed:
            folder.claim(one, one.described(spec))
        scene_ids = range(len(task.lights) * spec.layouts)
        lost = make_missing(
            task,
            [k for k in scene_ids if not _all_there(folder.finished, *task.named(k))],
            what="scans",
            total=len(scene_ids),
            workers=workers,
            progress=progress,
            on_result=keep,
            on_failed=lambda failed: on_failed(*named(failed.scene_id), failed),
        )
    return tuple("{}/{:03d}".format(*named(scene_id)) for scene_id in lost)


def _light_name(group: tuple[Placed, ...]) -> str:
    lit: Setting = group[0].setting
    return lit.name if len(group) == 1 else lit.lit.name


def _all_there(
    finished: Callable[[str, int], bool], group: tuple[Placed, ...], layout: int
) -> bool:
    return all(finished(placed.setting.name, layout) for placed in group)
