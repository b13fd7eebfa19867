"""Workers that make scenes: this process, processes of this machine, or a Ray cluster."""

from ...base.progress import UNWATCHED, ProgressMeter
from .job import Job, Made, TaskRunner, keep_to_threads
from .maker import SceneMaker, SceneTask
from .pool import TRIES, Failed, Pool, make_all, make_each
from .worker_renderer import KeptRenderer

__all__ = [
    "TRIES",
    "Failed",
    "Job",
    "KeptRenderer",
    "Made",
    "Pool",
    "SceneMaker",
    "SceneTask",
    "TaskRunner",
    "keep_to_threads",
    "make_all",
    "make_each",
    "open_pool",
]


def open_pool(
    task: Job,
    *,
    engine: str = "local",
    workers: int = 1,
    threads: int | None = None,
    address: str | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> Pool:
    """Workers for the scenes of a task; close them after use.

    Args:
        engine: 'local' or 'ray'.
        workers: scenes that are made at a time. Local: one is this process, more are processes of
            their own. Ray: at most so many; 0 takes as many as the cluster has room for.
        threads: processor threads per worker; None shares this machine's out among local workers,
            and is one on Ray.
        address: of a Ray cluster's head; None starts Ray on this machine.
        progress: hears of each scene what `make_scene` does, where this process makes all.

    Raises:
        GraycastError: Ray is not installed, or does not answer.
        ValueError: no such engine.
    """
    match engine:
        case "local" if workers == 1:
            from .here import Here

            return Here(task, threads=threads, progress=progress)
        case "local":
            from .local import LocalPool

            return LocalPool(task, workers=workers, threads=threads)
        case "ray":
            from .cluster import RayPool

            return RayPool(task, workers=workers, threads=threads or 1, address=address)
    raise ValueError(f"no engine {engine!r}: choose 'local' or 'ray'")
