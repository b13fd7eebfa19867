"""Many scenes on a pool of workers; failed scenes are retried and finally set aside."""

import traceback
from collections import Counter, deque
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ...base.errors import GraycastError, one_line
from ...base.progress import ProgressMeter
from ...dataset.write.set_aside import SetAside
from .job import Job, TaskResult, is_foreseen, is_the_scenes_own

TRIES = 3
# If this many scenes, in addition to those in progress, are lost in a row, the machine is faulty.
_IN_VAIN = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """A scene that failed after `tries` tries; if `final`, no further try follows.

    A scene whose own values cause the error is not tried again, because it would fail again.
    """

    scene_id: int
    error: Exception
    tries: int = 1
    final: bool = False

    def set_aside(self) -> SetAside:
        """Return the record of the scene that is given up."""
        foreseen = is_foreseen(self.error)
        trace = "" if foreseen else "".join(traceback.format_exception(self.error))
        return SetAside(
            scene_id=self.scene_id,
            tries=self.tries,
            reason=_error_text(self.error),
            traceback=trace,
        )

    def for_users(self) -> Exception:
        """Return the error for the user; the text of an unforeseen error says so, with its type."""
        if is_foreseen(self.error):
            return self.error
        text = f"{_error_text(self.error)}: this is an error in Graycast or in the machine"
        wrapped = GraycastError(text)
        wrapped.__cause__ = self.error
        return wrapped


def _error_text(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if is_foreseen(error) and text else f"{type(error).__name__} {text}".rstrip()


@runtime_checkable
class Pool(Protocol):
    """Workers that take scenes and return them in any order."""

    @property
    def free(self) -> int:
        """Number of scenes that may be submitted now."""
        ...

    def submit(self, scene_id: int) -> None:
        """Let a free worker make a scene."""
        ...

    def gather(self) -> TaskResult | Failed:
        """Wait for the next scene that succeeds or fails."""
        ...

    def close(self) -> None:
        """Stop the workers, also in the middle of a scene."""
        ...


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


def make_all(pool: Pool, scene_ids: Iterable[int]) -> Generator[TaskResult | Failed, None, None]:
    """Yield every finished scene. A failed scene is retried later, up to `TRIES` times.

    Raises:
        GraycastError: scene after scene failed for a reason outside the scenes, such as a failed
            driver or full memory, so further scenes would fail, too.
    """
    waiting, failures, running = deque(scene_ids), Counter[int](), 0
    lost: set[int] = set()  # scenes lost since the last finished one
    while waiting or running:
        while waiting and pool.free:
            pool.submit(waiting.popleft())
            running += 1
        at_work = running
        outcome = pool.gather()
        running -= 1
        if isinstance(outcome, TaskResult):
            lost.clear()
            yield outcome
            continue
        scene_id, error = outcome.scene_id, outcome.error
        failures[scene_id] += 1
        own = is_the_scenes_own(error)
        final = own or failures[scene_id] >= TRIES
        if not final:
            waiting.append(scene_id)
        yield Failed(scene_id=scene_id, error=error, tries=failures[scene_id], final=final)
        if not own:
            lost.add(scene_id)
        if len(lost) >= _IN_VAIN + at_work:
            why = one_line(error)
            raise GraycastError(
                f"{len(lost)} scenes in a row were lost, the last because {why}: repair the "
                "machine and run the same command again; the finished scenes are kept"
            ) from error
