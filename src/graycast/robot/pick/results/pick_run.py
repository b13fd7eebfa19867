"""Empty many bins of one cell in worker processes, and write the results to a folder of picks."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ....base.progress import UNWATCHED, ProgressMeter
from ....base.usage import rss_bytes
from ....cell.engine import ALONE, Failed, Job, TaskResult, WorkerRenderer, Workers, make_missing
from ....world.parts import Part
from ..bin.episode import empty_bin
from ..bin.ready import Ready, make_ready
from ..bin.robot_cell import PickCell
from .pick_files import episode_files, open_picks


class BinEmptier:
    """A worker that empties bins; it opens the renderer and the robot once."""

    def __init__(self, task: "PickTask", *, threads: int | None, progress: ProgressMeter) -> None:
        self._task, self._progress = task, progress
        self._renderers = WorkerRenderer(device=task.device, threads=threads, progress=progress)
        self._ready: Ready | None = None

    def make(self, scene_id: int) -> TaskResult:
        """Empty one bin.

        Raises:
            DropError, ValueError: this bin cannot be filled; other bins may be possible.
            ConfigError: the robot, the tool or the place does not suit the cell.
        """
        start = time.perf_counter()
        task = self._task
        with self._renderers.of(task.cell.cell.config.render) as renderer:
            if self._ready is None:
                self._ready = make_ready(task.cell, progress=self._progress)
            episode = empty_bin(
                self._ready, renderer, scene_id, seed=task.seed, progress=self._progress
            )
        outcomes = [str(attempt.outcome) for attempt in episode.attempts]
        return TaskResult(
            scene_id=scene_id,
            files=episode_files(episode),
            seconds=time.perf_counter() - start,
            reasons={name: float(outcomes.count(name)) for name in sorted(set(outcomes))},
            rss_bytes=rss_bytes(),
        )

    def close(self) -> None:
        self._renderers.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class PickTask(Job):
    """The data that a worker process needs to empty any bin of a cell."""

    RUNNER = BinEmptier

    cell: PickCell

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.cell.cell.scene.parts


def pick(
    cell: PickCell,
    out: Path | str,
    *,
    bins: int,
    seed: int,
    device: str = "auto",
    workers: Workers = ALONE,
    on_result: Callable[[TaskResult], None] = lambda _: None,
    on_failed: Callable[[Failed], None] = lambda failed: None,
    progress: ProgressMeter = UNWATCHED,
) -> tuple[int, ...]:
    """Empty the bins 0 to bins - 1, except those that are finished in `out`.

    Args:
        out: the folder of picks. It is created, or continued if it has the same cell and seed.
        device: device of the renderer.
        on_result: receives each result.
        on_failed: receives each failed attempt at a bin, with the reason.

    Returns:
        The ids of the bins that failed.

    Raises:
        DatasetError: the folder has another cell's picks, is in use, or cannot be written.
        DeviceError: this machine does not have the device.
        GraycastError, ValueError: no bin could be made; the error names the reason.
    """
    out = Path(out)
    device = workers.device(cell.config.render.backend, device)
    task = PickTask(cell=cell, seed=seed, device=device)

    def keep(result: TaskResult) -> None:
        folder.write(result.scene_id, result.files)
        on_result(result)

    with open_picks(out, cell, seed=seed) as folder:
        finished = folder.finished()
        lost = make_missing(
            task,
            [bin_id for bin_id in range(bins) if bin_id not in finished],
            what="bins",
            total=bins,
            workers=workers,
            progress=progress,
            on_result=keep,
            on_failed=on_failed,
        )
    return tuple(one.scene_id for one in lost)
