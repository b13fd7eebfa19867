"""Files of a dataset put into an export."""

import os
import shutil
from pathlib import Path

from ...base.errors import GraycastError


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
        raise GraycastError(f"{target}: {why}: export to the same disk, or omit --link") from error


def bop_key(scene_id: int, place: int) -> str:
    """BOP's name of a picture: its scene's number, and its own among those of all scanners."""
    return f"{scene_id:06d}_{place:06d}"
