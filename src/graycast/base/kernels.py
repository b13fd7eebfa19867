"""Functions that Numba compiles; the compiled code is kept on disk.

Numba's own cache notices only that the file of a function has changed. A kernel also uses functions
and constants from other files, and the compiled code contains them. Here the kernels of a file are
stored in a folder whose name has a digest of that file and of all files of this package that it
imports, directly or indirectly. So no list of dependencies is needed, and a change elsewhere in the
package causes no new compilation. Nothing is read or written before the first compilation.

The cache is optional: if no folder can be written, each process compiles the kernels that it uses.
"""

import hashlib
import inspect
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any, final

import numba
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    NullCache,
    _CacheLocator,
)
from numba.core.dispatcher import Dispatcher

from .folder import cache_folder, why_unwritable

MOST_VERSIONS = (
    16  # Each clone or branch needs a folder for the kernels of a file; older folders are removed.
)

_ROOT = Path(__file__).parents[1]
_START_NS = time.time_ns()
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+(\.*)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|(?:[^\n\\]|\\\n)*)"
    r"|import[ \t]+([\w., \t]+))",
    re.MULTILINE,
)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function at its first call, with options of `numba.njit`.

    In tests, the check of array annotations wraps every function. Numba cannot compile the
    wrapper, so the wrapped function is compiled.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(inspect.unwrap(function))
        if isinstance(dispatcher, Dispatcher):  # With NUMBA_DISABLE_JIT, njit returns the function.
            dispatcher._cache = _KernelCache(dispatcher.py_func)
        return dispatcher

    return compiled


def kernel_folder() -> Path | None:
    """Return the folder of all compiled kernels, or None if the user has no home folder.

    It is `$NUMBA_CACHE_DIR` if this is set, or else a folder in the user's cache folder.
    """
    return Path(numba.config.CACHE_DIR) if numba.config.CACHE_DIR else cache_folder("kernels")


def uncached_note() -> str | None:
    """Return the reason why compiled kernels are not stored on disk, or None without a problem."""
    return _problem(kernel_folder()) if _problem.cache_info().currsize else None


@cache
def _problem(folder: Path | None) -> str | None:
    """Return the reason why compiled kernels cannot be stored in a folder, or None if they can."""
    return "this user has no home" if folder is None else why_unwritable(folder)


@cache
def package_files() -> dict[str, Path]:
    """Return the file of each module of this package by the module's full name."""
    files = {}
    for folder, _, names in os.walk(_ROOT):
        package = ".".join([_ROOT.name, *Path(folder).relative_to(_ROOT).parts])
        for name in names:
            stem, ending = os.path.splitext(name)
            if ending == ".py":
                files[package if stem == "__init__" else f"{package}.{stem}"] = Path(folder, name)
    return files


@cache
def imported_modules(module: str) -> frozenset[str]:
    """Return the modules of this package that a module imports itself, anywhere in its code.

    Text that only looks like an import may add modules, which does no harm.
    """
    file = package_files()[module]
    parts = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
    names: set[str] = set()
    for dots, origin, objects, plain in _IMPORT.findall(file.read_text(encoding="utf-8")):
        above = parts[: len(parts) + 1 - len(dots)] if dots else []
        start = ".".join([*above, *filter(None, [origin])])
        names |= {start, *(f"{start}.{name}" for name in re.findall(r"\w+", objects))}
        names.update(re.findall(r"[\w.]+", plain))
    return frozenset(names & package_files().keys())


def all_imported_modules(module: str) -> list[str]:
    """Return a module and all modules of this package that it imports, directly or indirectly."""
    modules, waiting = {module}, [module]
    while waiting:
        news = imported_modules(waiting.pop()) - modules
        modules |= news
        waiting += news
    return sorted(modules)


@cache
def _content_digest(file: Path) -> bytes | None:
    """Return the digest of a file, or None if it has changed since this process began."""
    state = file.stat()
    if max(state.st_mtime_ns, state.st_ctime_ns) > _START_NS:
        return None
    return hashlib.sha256(file.read_bytes()).digest()


@cache
def sources_digest(module: str) -> str | None:
    """Return the digest of all files whose code the kernels of a module may contain.

    It is None if one of the files has changed since this process began. Code that is then compiled
    comes from the old text, which the process has loaded, and not from the text of the digest.
    """
    whole = hashlib.sha256()
    for name in all_imported_modules(module):
        content = _content_digest(package_files()[name])
        if content is None:
            return None
        whole.update(f"{name}\n".encode() + content)
    return whole.hexdigest()[:16]


@final
class _Locator(_CacheLocator):
    """Locator of the folder for one file's kernels; the folder's name has their sources' digest."""

    def __init__(self, file: str, line: int, module: str, folder: Path) -> None:
        self._py_file, self._line, self._module = file, line, module
        self._folder = folder

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "_Locator | None":
        """Return the locator of a function's compiled code; None if no folder can be written."""
        module, folder = py_func.__module__, kernel_folder()
        if _problem(folder) is not None or folder is None or module not in package_files():
            return None
        try:
            digest = sources_digest(module)
            if digest is None:
                return None
            line = py_func.__code__.co_firstlineno
            locator = cls(py_file, line, module, folder / f"{module}-{digest}")
            locator.ensure_cache_path()
            os.utime(locator._folder)  # The modification time is the time of the last use.
        except OSError:
            return None
        return locator

    def ensure_cache_path(self) -> None:
        if not self._folder.is_dir():
            self._folder.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):  # Another process may remove the same folders.
                self._forget_old()
        if (problem := why_unwritable(self._folder)) is not None:
            raise OSError(problem)

    def _forget_old(self) -> None:
        """Remove the least recently used folders of this file's kernels.

        If another process uses one of these folders, it compiles the missing kernels again.
        """
        versions = self._folder.parent.glob(f"{self._module}-{'[0-9a-f]' * 16}")
        aged = sorted(versions, key=lambda folder: folder.stat().st_mtime_ns, reverse=True)
        for folder in aged[MOST_VERSIONS:]:
            shutil.rmtree(folder, ignore_errors=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return ""  # The folder's name has the digest of the sources.

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Results(CompileResultCacheImpl):
    _locator_classes = (_Locator,)


class _Files(IndexDataCacheFile):
    """The index of one kernel, and a file for each of its signatures.

    Numba numbers these files, and writes the index first. If two processes store two signatures
    at once, both get the same number, and a process may then load code for the wrong signature.
    """

    def save(self, key: object, data: object) -> None:
        name = f"{self._index_name.removesuffix('.nbi')}.{secrets.token_hex(6)}.nbc"
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})


class _DiskCache(FunctionCache):
    _impl_class = _Results

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _Files(
            cache_path=self._cache_path, filename_base=self._impl.filename_base, source_stamp=""
        )


@final
class _KernelCache(NullCache):
    """The cache of one kernel, which is opened when the kernel is first compiled."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @cached_property
    def _disk(self) -> _DiskCache | None:
        try:
            return _DiskCache(self._function)
        except RuntimeError:  # Numba found no folder that can be written.
            return None

    @property
    def cache_path(self) -> str | None:
        return None if self._disk is None else self._disk.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        if self._disk is None:
            return None
        try:
            return self._disk.load_overload(sig, target_context)
        except Exception:  # A damaged file can raise anything: compile again.
            self.flush()
            return None

    def save_overload(self, sig: Any, cres: Any) -> None:
        with suppress(OSError):  # The disk may be full, or another process has removed the folder.
            if self._disk is not None:
                self._disk.save_overload(sig, cres)

    def flush(self) -> None:
        with suppress(OSError):
            if self._disk is not None:
                self._disk.flush()
