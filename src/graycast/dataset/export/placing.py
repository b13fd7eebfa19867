"""Copy or link a dataset's files into an export, or pack them into tar files."""

import io
import os
import shutil
import tarfile
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import TypeVar

from ...base.errors import GraycastError

T = TypeVar("T")
Sample = tuple[str, list[tuple[str, bytes]]]  # a key, and its files by their endings


def place(source: Path, target: Path, *, link: bool) -> None:
    """Copy a file, or make a hard link to it.

    Raises:
        GraycastError: the link is not possible.
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
    """Return BOP's name of a picture: the scene's number and the picture's index in the scene."""
    return f"{scene_id:06d}_{place:06d}"


def groups(items: Iterable[T], most: int) -> Iterator[Iterator[T]]:
    """Split items lazily into groups of at most `most`, so that memory use stays constant."""
    left = iter(items)
    for first in left:
        yield chain([first], islice(left, most - 1))


def write_shards(folder: Path, samples: Iterable[Sample], *, most: int) -> dict[str, int]:
    """Write `shard-000000.tar` ... with at most `most` samples per file.

    As in WebDataset, a sample consists of consecutive files KEY.name. Equal samples give equal
    bytes, because the entries hold no times, owners or names of the machine.

    Returns:
        The number of the shard that holds each key.
    """
    shard_of: dict[str, int] = {}
    for number, group in enumerate(groups(samples, most)):
        name = folder / f"shard-{number:06d}.tar"
        with tarfile.open(name, "w", format=tarfile.USTAR_FORMAT) as shard:
            for key, files in group:
                for ending, content in files:
                    entry = tarfile.TarInfo(f"{key}.{ending}")
                    entry.size = len(content)
                    shard.addfile(entry, io.BytesIO(content))
                shard_of[key] = number
    return shard_of
