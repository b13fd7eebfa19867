"""Results that appear whole or not at all: a file, or all files of a folder."""

import fcntl
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from .errors import DatasetError, GraycastError

ASIDE = ".tmp-"


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place and rename it: there it is as it was, or as it is to be.

    Raises:
        GraycastError: the folder is missing or the disk refuses.
    """
    fill_whole(path, lambda file: file.write(content))


def fill_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """The same for what is written piece by piece.

    Args:
        path: in a folder that is there.
        write: fills the open file.

    Raises:
        GraycastError: the folder is missing or the disk refuses; what was there is as it was.
    """
    try:
        with beside(path) as aside, open(aside, "xb") as file:
            write(file)
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{path}: cannot be written ({why}): give a path in a folder with space"
        ) from error


@contextmanager
def beside(place: Path) -> Iterator[Path]:
    """A path to write a file or a folder to, renamed to `place` when the block ends well.

    Otherwise it is removed. What a killed run leaves has a name that begins with `ASIDE`.

    Raises:
        OSError: the disk refuses, or `place` is a folder that holds something.
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
    """A folder to fill in `out`, whose files are moved up into `out` when the block ends well.

    `out` may hold other files, which stay. The folder is made first, so that a path that cannot be
    written stops a command before its work, not after. When the block fails or is stopped, `out`
    is as it was before, or is not there.

    Raises:
        GraycastError: `out` cannot be written.
    """
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        with _refusals(out), _aside(out, ".part-") as aside:
            yield aside
            for made_now in sorted(aside.iterdir()):
                place = out / made_now.name
                if made_now.is_dir() and place.is_dir():
                    place.rename(aside / f".before-{place.name}")  # no folder replaces a full one
                made_now.rename(place)
    finally:
        with suppress(OSError):  # what holds something stays: the result, or what was there
            for folder in made:
                folder.rmdir()


def take_lock(file: Path) -> IO[str] | None:
    """A file that is locked until it is closed or its process ends; None where another holds it.

    Raises:
        OSError: the file cannot be made, or the disk knows no locks.
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
    """Make a folder with one inside it, and be the only one who writes there.

    Raises:
        DatasetError: another run writes there, or the disk refuses.
    """
    try:
        (out / inside).mkdir(parents=True, exist_ok=True)
        lock = take_lock(out / lock_name)
    except OSError as error:
        raise DatasetError(
            f"{out}: cannot be written ({error.strerror}): choose a writable folder"
        ) from error
    if lock is None:
        raise DatasetError(f"another run is writing to {out}: wait for it, or choose another")
    with lock:
        yield


def refuse_foreign(out: Path, mark: str) -> None:
    """Results of one kind share no folder with anything else.

    Args:
        out: where they are to go: not there, empty, or holding an earlier result.
        mark: the file by which an earlier result is known.

    Raises:
        GraycastError: `out` is a file, or holds something else.
    """
    if out.exists() and not out.is_dir():
        raise GraycastError(f"{out}: is a file: choose a folder")
    if not out.exists() or (out / mark).exists():
        return
    with _refusals(out):
        held = sorted(entry.name for entry in out.iterdir() if not entry.name.startswith(".part-"))
    if held:
        raise GraycastError(
            f"{out}: is not empty and holds no earlier result of this command (it has {held[0]}): "
            "choose another folder"
        )


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder beside `out` to fill, renamed to `out` in one step when the block ends well.

    For what is one thing of many files and shares its folder with nothing.

    Raises:
        GraycastError: `out` is there and not empty, or cannot be written.
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
    """A hidden folder that is gone at the end; those that killed runs left go first.

    Its lock tells the folder of a run that is going on from one that was left. Where the disk
    knows no locks (some networks'), what was left stays.
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
            f"{out}: cannot be written ({why}): choose a writable folder with space"
        ) from error
