"""The tasks of workers, their results, and the renderer that a worker keeps between scenes."""

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
    """A scene: files as (path in its folder, content), seconds, shares of pixels per reason.

    `reason_px` and `part_reason_px` are the numbers of pixels per reason over all images: of all
    pixels, and of those that see parts. For a bin of a robot, `reasons` are attempts per
    outcome. `rss_bytes` is the memory of the process after the scene. A job that keeps its shots
    has `shots` in place of files.
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
        """Return the shares of reasons among the pixels that see parts; empty if no pixel does."""
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
    """The renderer of a worker: opened at its first use, closed after an unforeseen error."""

    def __init__(self, *, device: str, threads: int | None, progress: ProgressMeter) -> None:
        self._device, self._threads, self._progress = device, threads, progress
        self._open: Renderer | None = None

    @contextmanager
    def of(self, render: RenderSection) -> Iterator[Renderer]:
        """Provide the renderer while a scene is made; a worker passes the same section each time.

        An error that the scene itself does not cause closes it, since it may have a lost device or
        half of a scene; the next scene opens another one.
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
    """Makes one scene, or one bin, after another; close it after use."""

    def make(self, scene_id: int) -> TaskResult: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A task that can be sent to a worker, which opens it to make its scenes.

    `device` exists here: 'auto' was resolved before, so that all workers use the same one; only for
    a cluster may it be 'auto'. `graycast` is the release. `RUNNER` is called with the job and the
    arguments of `open`.
    """

    RUNNER: ClassVar[Callable[..., TaskRunner]]

    seed: int
    device: str
    graycast: str = __version__

    @property
    def parts(self) -> Sequence[Part]:
        """Return the kinds of parts that fall."""
        return ()

    def compile_kernels(self) -> None:
        """Compile on this machine what every worker would compile otherwise; nothing by default."""

    def open(
        self, *, threads: int | None = None, progress: ProgressMeter = UNWATCHED
    ) -> TaskRunner:
        """Open a maker of the job's scenes in this process; close it after use.

        Args:
            threads: processor threads that it may use; None leaves them as they are.
            progress: hears what is done for each scene.
        """
        return type(self).RUNNER(self, threads=threads, progress=progress)
