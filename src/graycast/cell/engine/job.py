"""The tasks of workers, their results, and the renderer that a worker has from scene to scene."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, final, runtime_checkable

import numba

from ...base.errors import DeviceError, GraycastError, WorkerDied
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.version import __version__
from ...camera.decode import pooled_shares
from ...rendering import Renderer
from ...world.parts import Part
from ..config import RenderSection
from ..resolve import open_configured
from ..simulate import Shot


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskResult:
    """A scene: its files as (path inside its folder, content), seconds, share of pixels per reason.

    `reason_px` and `part_reason_px` are the numbers of pixels per reason, among all and among those
    that see parts, over all images. Of a bin that a robot emptied `reasons` are attempts per
    outcome. `rss_bytes` is the memory of the process that made it, afterwards. `shots` are there
    instead of files where the job keeps them.
    """

    scene_id: int
    files: tuple[tuple[str, bytes], ...]
    seconds: float
    reasons: dict[str, float]
    rss_bytes: int
    reason_px: dict[str, int] = field(default_factory=dict)
    part_reason_px: dict[str, int] = field(default_factory=dict)
    shots: tuple[Shot, ...] = ()

    @property
    def part_reasons(self) -> dict[str, float]:
        """The shares of the pixels that see parts; empty where none does."""
        return pooled_shares([self.part_reason_px])


def keep_to_threads(threads: int | None) -> None:
    """Limit Numba to this number of threads; None does not change it."""
    if threads is not None:
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


def is_the_scenes_own(error: BaseException) -> bool:
    """Return whether the scene itself causes an error, so that another try would fail, too.

    Other errors (a lost driver, memory, a killed process) may be caused by the machine.
    """
    return is_foreseen(error) and not isinstance(error, (DeviceError, WorkerDied))


def is_foreseen(error: BaseException) -> bool:
    """Return whether the text of an error tells a user what to do."""
    return isinstance(error, (GraycastError, ValueError))


@final
class WorkerRenderer:
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


@runtime_checkable
class TaskRunner(Protocol):
    """Makes one scene after the other, or one bin; close it after use."""

    def make(self, scene_id: int) -> TaskResult: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A task that can be sent to a worker, which opens it to make its scenes.

    `device` is one that is there: 'auto' was settled before, so that all workers take the same. For
    a cluster it may be 'auto'. `graycast` is the release. `RUNNER` is called
    with the job and the arguments of `open`.
    """

    RUNNER: ClassVar[Callable[..., TaskRunner]]

    seed: int
    device: str
    graycast: str = __version__

    @property
    def parts(self) -> Sequence[Part]:
        """The kinds of parts that fall."""
        return ()

    def compile_kernels(self) -> None:
        """Compile once on this machine what every worker would compile; by default nothing."""

    def open(
        self, *, threads: int | None = None, progress: ProgressMeter = UNWATCHED
    ) -> TaskRunner:
        """A maker of the job's scenes in this process; close it after use.

        Args:
            threads: processor threads that it may use; None leaves them as they are.
            progress: hears what is done for each scene.
        """
        return type(self).RUNNER(self, threads=threads, progress=progress)
