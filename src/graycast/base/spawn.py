"""Processes that Python starts from scratch, because a JIT's threads do not survive a fork.

Python's `spawn` runs the user's script again in each process, so a script without the guard
`if __name__ == "__main__"` would end in an error. Our processes need nothing from the script,
because their functions and data come from modules.
"""

import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, TypeVar

from .errors import WorkerDied

Item = TypeVar("Item")
Result = TypeVar("Result")


class _Process(SpawnProcess):
    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return SpawnProcess._Popen(process_obj)
        finally:
            sys.modules["__main__"] = script


class _Context(SpawnContext):
    Process = _Process


SPAWN = _Context()  # replaces `multiprocessing.get_context("spawn")`


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Block Ctrl-C for processes that start in the block, because their parent ends them.

    The processes inherit the signal mask, and the parent's own mask is restored at the end.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def in_order(
    function: Callable[[Item], Result], items: Sequence[Item], *, workers: int
) -> Generator[Result, None, None]:
    """Yield the result of a function for each item, in the order of the items.

    The workers are at most two items each ahead, so that memory use stays constant.

    Raises:
        WorkerDied: a worker was killed.
    """
    if workers == 1 or len(items) < 2:
        yield from map(function, items)
        return
    with ProcessPoolExecutor(min(workers, len(items)), mp_context=SPAWN) as pool:
        others = iter(items)
        try:
            with deaf_to_interrupts():
                ahead = deque(pool.submit(function, item) for item in islice(others, 2 * workers))
            while ahead:
                yield ahead.popleft().result()
                ahead.extend(pool.submit(function, item) for item in islice(others, 1))
        except BrokenProcessPool as error:
            raise WorkerDied(
                "a worker process was killed, by a user or by the operating system for lack of "
                f"memory: run the command again with fewer than {workers} workers"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)
