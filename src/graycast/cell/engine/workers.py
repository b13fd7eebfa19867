"""The choice of workers: this process, other processes of this machine, or a cluster."""

from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import dataclass

from ...base.progress import UNWATCHED, ProgressMeter
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...rendering import choose_device
from ...world.drop import hull_notes, prepare
from .job import Job, TaskResult
from .pool import Failed, Here, Pool, make_all

HOPELESS = 3  # If this many scenes are given up before one is finished, the run stops.
MOST_THREADS = 1024  # Blender's own limit; tens of thousands of threads end the process.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """A choice of workers for the scenes.

    `engine` is 'local' or 'ray'. `count` scenes are made at a time. With 'local', 1 means this
    process, and more mean child processes; with 'ray', 0 means as many as the cluster has room for.
    `threads` are processor threads per worker; None divides this machine's threads among local
    workers, and means one on Ray. `address` belongs to a Ray cluster's head; None starts Ray here.
    """

    engine: str = "local"
    count: int = 1
    threads: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        least = 0 if self.engine == "ray" else 1
        if self.count < least:
            raise ValueError(
                f"count is {self.count}: give the number of workers, {least} or more"
                + ("" if least == 0 else "; only with engine 'ray' 0 means as many as there are")
            )
        if self.threads is not None and not 1 <= self.threads <= MOST_THREADS:
            raise ValueError(
                f"threads is {self.threads} per worker; give 1 to {MOST_THREADS}: more threads "
                "than processors do not make a run faster"
            )

    def device(self, backend: str, wanted: str) -> str:
        """Return the device of all workers; on a cluster, 'auto' lets each machine choose its own.

        Raises:
            DeviceError: this machine has no such device.
        """
        return wanted if self.engine == "ray" else choose_device(backend, wanted)


ALONE = Workers()


def open_pool(
    task: Job, workers: Workers = ALONE, *, scenes: int, progress: ProgressMeter = UNWATCHED
) -> Pool:
    """Open workers for the scenes of a task, at most one for each scene; close the pool after use.

    Args:
        progress: called with the steps of `make_scene` if this process makes all scenes.

    Raises:
        GraycastError: Ray is not installed, or does not answer.
        ValueError: there is no such engine.
    """
    count, threads = min(workers.count, scenes), workers.threads
    match workers.engine:
        case "local" if count == 1:
            return Here(task, threads=threads, progress=progress)
        case "local":
            from .local import LocalPool

            return LocalPool(task, workers=count, threads=threads)
        case "ray":
            from .cluster import RayPool

            return RayPool(task, workers=count, threads=threads or 1, address=workers.address)
    raise ValueError(f"no engine {workers.engine!r}: choose 'local' or 'ray'")


def make_missing(
    task: Job,
    missing: Collection[int],
    *,
    what: str,
    total: int,
    workers: Workers = ALONE,
    progress: ProgressMeter,
    on_result: Callable[[TaskResult], None],
    on_failed: Callable[[Failed], None],
) -> tuple[Failed, ...]:
    """Make the missing scenes, and pass on each result at once.

    Every command that continues a stopped run calls this function. A scene that fails because of
    the machine is tried again, as in `make_all`; a scene that is given up is set aside. The
    collision hulls of the job's parts, and the kernels for several processes of this machine, are
    made first, once for all workers.

    Args:
        what: the kind of scenes, for `progress`.
        total: number of scenes, including scenes of earlier runs.
        on_result, on_failed: called with each result or failed try, to write and show it.
        progress: counts the scenes, and notes each part whose collision hulls are coarse.

    Returns:
        The scenes that were given up, in the order of their numbers.

    Raises:
        GraycastError: as in `make_all`.
        Exception: the error of a scene, if there is no finished scene, and all scenes, or the first
            `HOPELESS`, were given up.
    """
    done = total - len(missing)
    progress.count(what, done, total)
    if not missing:
        return ()
    prepared = prepare(task.parts, progress=progress)
    for note in hull_notes(task.parts, prepared):
        progress.note(note)
    if workers.engine == "local" and min(workers.count, len(missing)) > 1:
        progress.stage("compiling the decoder, once on this machine")
        task.compile_kernels()
    lost: list[Failed] = []
    with closing(open_pool(task, workers, scenes=len(missing), progress=progress)) as pool:
        for outcome in make_all(pool, missing):
            if isinstance(outcome, TaskResult):
                on_result(outcome)
                done += 1
                progress.count(what, done, total)
                continue
            if outcome.final:
                lost.append(outcome)
                if not done and len(lost) >= min(HOPELESS, len(missing)):
                    raise outcome.for_users()
            on_failed(outcome)
    return tuple(sorted(lost, key=lambda scene: scene.scene_id))
