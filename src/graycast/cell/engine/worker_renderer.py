"""A renderer that a worker keeps from scene to scene."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import final

from ...base.progress import ProgressMeter
from ...rendering import Renderer
from ..config import RenderSection
from ..resolve import open_configured
from .job import is_the_scenes_own, keep_to_threads


@final
class KeptRenderer:
    """The renderer of a worker: opened when it is first used, and never kept after a surprise."""

    def __init__(self, *, device: str, threads: int | None, progress: ProgressMeter) -> None:
        self._device, self._threads, self._progress = device, threads, progress
        self._open: Renderer | None = None

    @contextmanager
    def of(self, render: RenderSection) -> Iterator[Renderer]:
        """While something is made with it. A worker is given the same section each time.

        After an error that is not the scene's own it is closed, since it may hold a lost device or
        the half of a scene, and the next scene opens another.
        """
        try:
            if self._open is None:
                keep_to_threads(self._threads)
                self._open = open_configured(
                    render, device=self._device, threads=self._threads, progress=self._progress
                )
            yield self._open
        except BaseException as error:
            if not is_the_scenes_own(error):
                self.close()
            raise

    def close(self) -> None:
        renderer, self._open = self._open, None
        if renderer is not None:
            renderer.close()
