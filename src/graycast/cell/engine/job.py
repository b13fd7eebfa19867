"""Tasks for workers, their results, and the renderer that a worker keeps between scenes."""

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
    """The result of a scene: files as (path in its folder, content), seconds, shares per reason.

    `reason_px` counts all pixels per reason over all images, and `part_reason_px` only the pixels
    that see parts. For a robot's bin, `reasons` are counts of attempts per outcome. `rss_bytes` is
    the memory of the process after the scene. A job that keeps its shots gives `shots` instead of
    files.
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
        """Shares of reasons among the pixels that see parts; empty if no pixel sees a part."""
        return pooled_shares([self.part_reason_px])


def keep_to_threads(threads: int | None) -> None:
    """Limit Numba to this number of threads; None does not change it."""
    if threads is not None:
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


def is_the_scenes_own(error: BaseException) -> bool:
    """Return whether an error is caused by the scene itself, so that a new try would also fail.

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

        An error that the scene itself does not cause closes the renderer, since it may have a lost
        device or half of a scene; the next scene opens a new renderer.
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
    """A maker of one scene, or bin, after another; close it after use."""

    def make(self, scene_id: int) -> TaskResult: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A task that can be sent to a worker, which opens it to make its scenes.

    `device` exists on this machine. 'auto' is resolved beforehand, so that all workers use the
    same device; only a job for a cluster may have 'auto'. `graycast` is the release. `RUNNER` is
    called with the job and the arguments of `open`.
    """

    RUNNER: ClassVar[Callable[..., TaskRunner]]

    seed: int
    device: str
    graycast: str = __version__

    @property
    def parts(self) -> Sequence[Part]:
        """Kinds of the parts that fall."""
        return ()

    def compile_kernels(self) -> None:
        """Compile kernels once on this machine, so that workers need not; nothing by default."""

    def open(
        self, *, threads: int | None = None, progress: ProgressMeter = UNWATCHED
    ) -> TaskRunner:
        """Open a maker of the job's scenes in this process; close it after use.

        Args:
            threads: number of processor threads for the maker; None does not change it.
            progress: called with each step of a scene.
        """
        return type(self).RUNNER(self, threads=threads, progress=progress)
