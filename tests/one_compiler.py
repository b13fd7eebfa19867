"""Workers side by side compile a kernel once: one of them, and the others load it."""

import fcntl
from typing import IO

from numba.core.event import Listener


class OneAtATime(Listener):
    """Numba's lock of a process, made a lock of all: it is taken again inside of itself.

    What a process finds compiled it looks up under this lock, so who had to wait finds it. Without
    it both compile, and of two that store their versions at once one is forgotten.
    """

    def __init__(self, file: IO[str]):
        self.file, self.depth = file, 0

    def on_start(self, event) -> None:
        if self.depth == 0:
            fcntl.flock(self.file, fcntl.LOCK_EX)
        self.depth += 1

    def on_end(self, event) -> None:
        self.depth -= 1
        if self.depth == 0:
            fcntl.flock(self.file, fcntl.LOCK_UN)
