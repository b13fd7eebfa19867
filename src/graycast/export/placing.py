"""Files put into a folder that appears whole or not at all."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import GraycastError


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder beside `out` to fill, renamed to `out` when the block ends well.

    `whole_folder` moves files one by one into a folder that may hold others; an export is one
    thing of many files, so it gets a folder of its own in one step. A killed run leaves a hidden
    folder `.OUT.part-...` beside it.

    Raises:
        GraycastError: `out` is there and not empty, or cannot be written.
    """
    out = out.absolute()
    if out.is_dir() and any(out.iterdir()):
        raise GraycastError(f"{out}: is not empty: choose another folder, or remove this one")
    if out.exists() and not out.is_dir():
        raise GraycastError(f"{out}: is a file: choose a folder")
    aside = out.with_name(f".{out.name}.part-{secrets.token_hex(4)}")
    try:
        aside.mkdir(parents=True)
        yield aside
        aside.rename(out)
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{out}: cannot be written ({why}): choose a writable folder with space"
        ) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def place(source: Path, target: Path, *, link: bool) -> None:
    """A copy of a file, or a second name of it on the same disk.

    Raises:
        GraycastError: a link is not possible.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if not link:
        shutil.copyfile(source, target)
        return
    try:
        os.link(source, target)
    except OSError as error:
        why = f"cannot be linked to {source} ({error.strerror})"
        raise GraycastError(f"{target}: {why}: export to the same disk, or copy") from error
