"""Files and folders that are written completely or not at all."""

import fcntl
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import IO

from .errors import DatasetError, GraycastError

ASIDE = ".tmp-"


def cache_folder(kind: str) -> Path | None:
    """Return the cache folder for results of a kind; the folder may not exist yet.

    It is in `$XDG_CACHE_HOME`, or else in `~/.cache`; None if the user has no home. Results can
    always be computed again, so callers must go on if the folder cannot be read or written.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "graycast" / kind
    except RuntimeError:  # No HOME is set, and the system does not know the user.
        return None


def why_unwritable(folder: Path) -> str | None:
    """Create a folder if it is missing; return the reason why it cannot be written, or None."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return f"{folder} cannot be written ({error.strerror or error})"
    return None


def visible_entries(folder: Path) -> list[Path]:
    """Return the entries of a folder in the order of their names, without hidden entries.

    On drives of other systems, macOS adds a file `._NAME` for each file, and file browsers add
    hidden files of their own. These files contain no data.
    """
    return sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))


def leads_out(name: str) -> bool:
    """Return whether a file name read from a list points outside the list's folder.

    Such a name is an absolute path or contains `..`, so it could refer to any file on the reader's
    machine. Windows' `\\` counts as `/`.
    """
    path = PurePosixPath(name.replace("\\", "/"))
    return path.is_absolute() or ".." in path.parts


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it, so it is never incomplete.

    Raises:
        GraycastError: the folder is missing or the operating system refuses.
    """
    fill_whole(path, lambda file: file.write(content))


def fill_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file as `write_whole` does, but in pieces, which a function writes.

    Args:
        path: the file, in a folder that exists.
        write: a function that writes to the open file.

    Raises:
        GraycastError: the folder is missing or the operating system refuses; an existing file
            is unchanged.
    """
    try:
        with beside(path) as aside, open(aside, "xb") as file:
            write(file)
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{path}: cannot be written ({why}): give a path in an existing folder with free space"
        ) from error


@contextmanager
def beside(place: Path) -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `place` when the block succeeds.

    If the block fails, the path is removed. If a run is killed, the path remains until the next run
    calls `remove_left`, which knows such paths by `ASIDE` at the start of their names.

    Raises:
        OSError: the operating system refuses, or `place` is a folder that is not empty.
    """
    aside = place.with_name(f"{ASIDE}{place.name}-{secrets.token_hex(4)}")
    try:
        yield aside
        os.replace(aside, place)
    finally:
        if aside.is_dir():
            shutil.rmtree(aside, ignore_errors=True)
        else:
            aside.unlink(missing_ok=True)


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `out`; its files are moved to `out` when the block succeeds.

    Other files in `out` are kept. The folder is made first, so that a command fails at once if it
    cannot write to `out`, and not after its work. If the block fails or is stopped, `out` is
    unchanged, or does not exist if it did not exist before.

    Raises:
        GraycastError: `out` cannot be written.
    """
    new_folders = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        with _refusals(out), _aside(out, ".part-") as aside:
            yield aside
            for entry in sorted(aside.iterdir()):
                place = out / entry.name
                if entry.is_dir() and place.is_dir():
                    # A folder cannot replace one that is not empty.
                    place.rename(aside / f".before-{place.name}")
                entry.rename(place)
    finally:
        with suppress(OSError):  # Only empty folders are removed.
            for folder in new_folders:
                folder.rmdir()


def take_lock(file: Path) -> IO[str] | None:
    """Lock a file until it is closed or the process ends; return None if it is locked already.

    Raises:
        OSError: the file cannot be made, or the file system has no locks.
    """
    lock = open(file, "a")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        if isinstance(error, BlockingIOError):
            return None
        raise
    return lock


@contextmanager
def claimed_folder(out: Path, inside: str, lock_name: str) -> Iterator[None]:
    """Make a folder and hold its lock during the block, so that no other run writes to it.

    Temporary paths of killed runs in `out`, in `inside` and in the folders of `inside` are removed.

    Raises:
        DatasetError: another run writes there, or the operating system refuses.
    """
    try:
        (out / inside).mkdir(parents=True, exist_ok=True)
        lock = take_lock(out / lock_name)
    except OSError as error:
        raise DatasetError(
            f"{out}: cannot be written ({error.strerror}): choose a writable folder"
        ) from error
    if lock is None:
        raise DatasetError(
            f"another run is writing to {out}: wait until it ends, or choose another folder"
        )
    with lock:
        with _refusals(out):
            within = [entry for entry in (out / inside).iterdir() if entry.is_dir()]
            remove_left(out, out / inside, *within)
        yield


def remove_left(*folders: Path) -> None:
    """Remove the temporary paths that killed runs left directly in these folders.

    This also removes the temporary paths of an active run, so first lock the result.

    Raises:
        OSError: the operating system refuses.
    """
    for left in [entry for folder in folders for entry in folder.glob(f"{ASIDE}*")]:
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()


def refuse_foreign(out: Path, mark: str) -> None:
    """Raise an error if a folder for results of one kind holds anything else.

    Args:
        out: the folder of the results: absent, empty, or with an earlier result.
        mark: the name of the file that marks an earlier result.

    Raises:
        GraycastError: `out` is a file, or has other content.
    """
    if out.exists() and not out.is_dir():
        raise GraycastError(f"{out}: is a file: choose a folder")
    if not out.exists() or (out / mark).exists():
        return
    with _refusals(out):
        names = sorted(entry.name for entry in out.iterdir() if not entry.name.startswith(".part-"))
    if names:
        raise GraycastError(
            f"{out}: is not empty and holds no earlier result of this command (it has {names[0]}): "
            "choose another folder"
        )


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Yield a temporary folder, which is renamed to `out` when the block succeeds.

    Use this for a result of many files that has a folder of its own.

    Raises:
        GraycastError: `out` exists and is not empty, or cannot be written.
    """
    out = out.absolute()
    if out.is_dir() and any(out.iterdir()):
        raise GraycastError(f"{out}: is not empty: choose another folder, or remove this one")
    if out.exists() and not out.is_dir():
        raise GraycastError(f"{out}: is a file: choose a folder")
    with _refusals(out), _aside(out.parent, f".{out.name}.part-") as aside:
        yield aside
        aside.rename(out)


@contextmanager
def _aside(parent: Path, prefix: str) -> Iterator[Path]:
    """Yield a new hidden folder and remove it at the end; first remove those that killed runs left.

    Its lock distinguishes the folder of a running process from an abandoned one. On file
    systems without locks, such as some network disks, abandoned folders stay.
    """
    parent.mkdir(parents=True, exist_ok=True)
    for left in [entry for entry in parent.iterdir() if entry.name.startswith(prefix)]:
        with suppress(OSError), _locked(left):
            shutil.rmtree(left)
    aside = parent / f"{prefix}{secrets.token_hex(4)}"
    try:
        aside.mkdir()
        with _locked(aside, needed=False):
            yield aside
    finally:
        shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def _locked(folder: Path, *, needed: bool = True) -> Iterator[None]:
    lock = os.open(folder, os.O_RDONLY)
    try:
        with suppress(*(() if needed else (OSError,))):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(lock)


@contextmanager
def _refusals(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{out}: cannot be written ({why}): choose a writable folder with free space"
        ) from error
