"""Many scenes on a pool of workers; failed scenes are retried and finally set aside."""

from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ...base.errors import ConfigError, DeviceError, GraycastError, one_line
from ...base.progress import ProgressMeter
from .job import TaskResult, is_the_scenes_own

TRIES = 3
# A machine that loses this many scenes one after another, besides those at work, is not well.
_IN_VAIN = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """A scene that did not come out; `tries` counts up to now, and `final` says that none follow.

    A scene whose own values are the cause is not tried again: it would fail the same way.
    """

    scene_id: int
    error: Exception
    tries: int = 1
    final: bool = False


@runtime_checkable
class Pool(Protocol):
    """Workers that take scenes and give them back, in any order."""

    @property
    def free(self) -> int:
        """How many scenes may be submitted now."""
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


def make_all(pool: Pool, scene_ids: Iterable[int]) -> Generator[TaskResult | Failed, None, None]:
    """Yield every finished scene. A failed one is retried later, up to `TRIES` times.

    Raises:
        GraycastError: scene after scene was lost and not by its own fault, so that the rest of them
            would be, too: a driver is gone, or the memory.
    """
    waiting, failures, running = deque(scene_ids), Counter[int](), 0
    lost: set[int] = set()  # since the last that came out
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


def make_each(
    pool: Pool,
    scene_ids: Collection[int],
    *,
    what: str,
    total: int,
    progress: ProgressMeter,
    on_result: Callable[[TaskResult], None],
    on_failed: Callable[[Failed], None],
) -> tuple[int, ...]:
    """Hand over every scene as it ends, and close the pool.

    Args:
        what: of which kind the scenes are, for `progress`.
        total: how many there are with those that were there before.
        on_result, on_failed: take the results, which are written and shown.

    Returns:
        The scenes that were given up.

    Raises:
        ConfigError, DeviceError: what serves no scene.
        Exception: that of the last scene, where all were given up.
        GraycastError: as of `make_all`.
    """
    lost: list[int] = []
    done = total - len(scene_ids)
    with closing(pool):
        for outcome in make_all(pool, scene_ids):
            if isinstance(outcome, TaskResult):
                on_result(outcome)
                done += 1
                progress.count(what, done, total)
                continue
            if isinstance(outcome.error, (ConfigError, DeviceError)):
                raise outcome.error
            on_failed(outcome)
            if outcome.final:
                lost.append(outcome.scene_id)
                if len(lost) == len(scene_ids):
                    raise outcome.error
    return tuple(lost)
