"""Let one of several parallel workers compile a kernel, and let the others load it."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from numba.core.dispatcher import Dispatcher


@contextmanager
def one_compiler_a_kernel(folder: Path) -> Iterator[None]:
    """Lock each kernel by its name while one of several processes compiles it for the cache.

    Without the lock, two processes would compile the same kernel, and if both store a version at
    the same time, one version is lost. Numba looks a kernel up after it takes the lock, so a
    process that waited for the lock loads the kernel. Compiling a kernel also compiles the kernels
    that it calls. Calls are not circular, so there is no deadlock.
    """
    compile_one, locked = Dispatcher.compile, set()

    def compile_alone(kernel, signature):
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        if not name.startswith("graycast.") or name in locked:
            return compile_one(kernel, signature)
        with open(folder / name, "w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # The lock lasts until the file is closed.
            locked.add(name)
            try:
                return compile_one(kernel, signature)
            finally:
                locked.remove(name)

    with mock.patch.object(Dispatcher, "compile", compile_alone):
        yield
