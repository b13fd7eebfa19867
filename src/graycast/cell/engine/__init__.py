"""Workers that make scenes: this process, processes of this machine, or a Ray cluster."""

from .job import Job, TaskResult, WorkerRenderer, keep_to_threads
from .maker import SceneMaker, SceneTask
from .pool import TRIES, Failed, Pool, make_all
from .workers import ALONE, HOPELESS, Workers, make_missing, open_pool

__all__ = [
    "ALONE",
    "HOPELESS",
    "TRIES",
    "Failed",
    "Job",
    "Pool",
    "SceneMaker",
    "SceneTask",
    "TaskResult",
    "WorkerRenderer",
    "Workers",
    "keep_to_threads",
    "make_all",
    "make_missing",
    "open_pool",
]
