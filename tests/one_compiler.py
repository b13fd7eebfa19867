"""Workers side by side compile a kernel once: one of them, and the others load it."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from numba.core.dispatcher import Dispatcher


@contextmanager
def one_compiler_a_kernel(folder: Path) -> Iterator[None]:
    """While it lasts, what a process of several compiles for numba's cache it locks by its name.

    Without it two processes compile the same, and of two that store versions of a kernel at once
    one is forgotten. Numba looks a kernel up after the lock is taken, so who had to wait finds it.
    While one is compiled so are those that it calls: a kernel calls none that waits for it.
    """
    compile_one, locked = Dispatcher.compile, set()

    def compile_alone(kernel, signature):
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        if not name.startswith("graycast.") or name in locked:
            return compile_one(kernel, signature)
        with open(folder / name, "w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # until it is closed
            locked.add(name)
            try:
                return compile_one(kernel, signature)
            finally:
                locked.remove(name)

    with mock.patch.object(Dispatcher, "compile", compile_alone):
        yield
