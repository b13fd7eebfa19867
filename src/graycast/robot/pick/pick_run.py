"""Many bins of one cell, emptied by workers and written to a folder of picks."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...base.progress import UNWATCHED, ProgressMeter
from ...base.usage import rss_bytes
from ...cell.engine import Failed, Job, KeptRenderer, Made, make_each, open_pool
from ...cell.generate import Workers
from ...render import choose_device
from ...world.drop import prepare
from .episode import empty_bin
from .pick_files import episode_files, open_picks
from .ready import Ready, make_ready
from .robot_cell import PickCell

ALONE = Workers()


@dataclass(frozen=True, slots=True, kw_only=True)
class PickTask(Job):
    """What a worker needs to know to empty any bin of a cell."""

    cell: PickCell

    def open(
        self,
        *,
        threads: int | None = None,
        progress: ProgressMeter = UNWATCHED,
    ) -> "BinEmptier":
        return BinEmptier(self, threads=threads, progress=progress)


class BinEmptier:
    """Empties bins of one task; renderer and robot are opened for the first one and kept."""

    def __init__(
        self,
        task: PickTask,
        *,
        threads: int | None,
        progress: ProgressMeter,
    ) -> None:
        self._task, self._progress = task, progress
        self._kept = KeptRenderer(device=task.device, threads=threads, progress=progress)
        self._ready: Ready | None = None

    def make(self, scene_id: int) -> Made:
        """One bin.

        Raises:
            DropError, ValueError: this bin cannot be filled; the next one may be.
            ConfigError: robot, tool or place do not suit the cell.
        """
        start = time.perf_counter()
        task = self._task
        with self._kept.of(task.cell.cell) as renderer:
            if self._ready is None:
                self._ready = make_ready(task.cell, progress=self._progress)
            episode = empty_bin(
                self._ready, renderer, scene_id, seed=task.seed, progress=self._progress
            )
        outcomes = [str(attempt.outcome) for attempt in episode.attempts]
        return Made(
            scene_id=scene_id,
            files=episode_files(episode),
            seconds=time.perf_counter() - start,
            reasons={name: float(outcomes.count(name)) for name in sorted(set(outcomes))},
            rss_bytes=rss_bytes(),
        )

    def close(self) -> None:
        self._kept.close()


def pick_bins(
    cell: PickCell,
    out: Path,
    *,
    bins: int,
    seed: int,
    device: str = "auto",
    workers: Workers = ALONE,
    on_made: Callable[[Made], None] = lambda made: None,
    on_failed: Callable[[Failed], None] = lambda failed: None,
    progress: ProgressMeter = UNWATCHED,
) -> tuple[int, ...]:
    """Empty the bins 0 .. bins-1 that are not in `out` yet.

    Args:
        out: the folder of picks; made, or continued where the same cell began it.
        device: of the renderer.
        on_made, on_failed: take results, as in `generate`.

    Returns:
        The bins that could not be made.

    Raises:
        DatasetError: the folder is another cell's, is in use, or the disk refuses.
        DeviceError: no such device here.
        GraycastError, ValueError: nothing came out, for this reason.
    """
    backend = cell.config.render.backend
    chosen = device if workers.engine == "ray" else choose_device(backend, device)
    task = PickTask(cell=cell, seed=seed, device=chosen)

    def keep(made: Made) -> None:
        folder.write(made.scene_id, made.files)
        on_made(made)

    with open_picks(out, cell, seed=seed) as folder:
        found = folder.finished()
        todo = [bin_id for bin_id in range(bins) if bin_id not in found]
        progress.count("bins", bins - len(todo), bins)
        if not todo:
            return ()
        prepare(cell.cell.scene.parts, progress=progress)  # once, not by every worker
        pool = open_pool(
            task,
            engine=workers.engine,
            workers=min(workers.count, len(todo)),
            threads=workers.threads,
            address=workers.address,
            progress=progress,
        )
        return make_each(
            pool,
            todo,
            what="bins",
            total=bins,
            progress=progress,
            on_made=keep,
            on_failed=on_failed,
        )
