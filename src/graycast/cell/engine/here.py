"""Scenes in this process, one after the other."""

from ...base.progress import ProgressMeter
from .job import Job, TaskResult
from .pool import Failed


class Here:
    """A pool with only this process: a submitted scene is made when it is gathered."""

    def __init__(self, task: Job, *, threads: int | None, progress: ProgressMeter) -> None:
        self._maker = task.open(threads=threads, progress=progress)
        self._next: int | None = None

    @property
    def free(self) -> int:
        return int(self._next is None)

    def submit(self, scene_id: int) -> None:
        self._next = scene_id

    def gather(self) -> TaskResult | Failed:
        scene_id, self._next = self._next, None
        assert scene_id is not None, "nothing was submitted"
        try:
            return self._maker.make(scene_id)
        except Exception as error:
            return Failed(scene_id=scene_id, error=error)

    def close(self) -> None:
        self._maker.close()
