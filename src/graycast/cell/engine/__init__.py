"""Workers that make scenes: this process, processes of this machine, or a Ray cluster."""

from ...render import OnFrame
from ..simulate import OnStage
from .job import Job, Made, Maker, keep_to_threads
from .maker import SceneMaker, SceneTask
from .pool import TRIES, Failed, Pool, make_all, make_each
from .worker_renderer import KeptRenderer

__all__ = [
    "TRIES",
    "Failed",
    "Job",
    "KeptRenderer",
    "Made",
    "Maker",
    "Pool",
    "SceneMaker",
    "SceneTask",
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
    on_frame: OnFrame | None = None,
    on_stage: OnStage = lambda stage: None,
) -> Pool:
    """Workers for the scenes of a task; close them after use.

    Args:
        engine: 'local' or 'ray'.
        workers: scenes that are made at a time. Local: one is this process, more are processes of
            their own. Ray: at most so many; 0 takes as many as the cluster has room for.
        threads: processor threads per worker; None shares this machine's out among local workers,
            and is one on Ray.
        address: of a Ray cluster's head; None starts Ray on this machine.
        on_frame: as in `open_renderer`, where this process makes all.
        on_stage: as in `make_scene`, where this process makes all.

    Raises:
        GraycastError: Ray is not installed, or does not answer.
        ValueError: no such engine.
    """
    match engine:
        case "local" if workers == 1:
            from .here import Here

            return Here(task, threads=threads, on_frame=on_frame, on_stage=on_stage)
        case "local":
            from .local import LocalPool

            return LocalPool(task, workers=workers, threads=threads)
        case "ray":
            from .cluster import RayPool

            return RayPool(task, workers=workers, threads=threads or 1, address=address)
    raise ValueError(f"no engine {engine!r}: choose 'local' or 'ray'")
