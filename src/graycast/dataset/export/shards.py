"""Tar files of samples in the order of the WebDataset convention: KEY.name, all of a key together.

Equal samples give equal bytes: no times, owners or names of the machine.
"""

import io
import tarfile
from collections.abc import Iterable
from pathlib import Path


def write_shards(
    folder: Path, samples: Iterable[tuple[str, Iterable[tuple[str, bytes]]]], *, most: int
) -> dict[str, int]:
    """Write `shard-000000.tar` ... with at most so many samples each.

    Returns:
        The number of the shard that holds each key.
    """
    shard_of: dict[str, int] = {}
    shard: tarfile.TarFile | None = None
    try:
        for key, files in samples:
            number = len(shard_of) // most
            if shard is None or len(shard_of) % most == 0:
                if shard is not None:
                    shard.close()
                name = folder / f"shard-{number:06d}.tar"
                shard = tarfile.open(name, "w", format=tarfile.USTAR_FORMAT)
            for ending, content in files:
                entry = tarfile.TarInfo(f"{key}.{ending}")
                entry.size = len(content)
                shard.addfile(entry, io.BytesIO(content))
            shard_of[key] = number
    finally:
        if shard is not None:
            shard.close()
    return shard_of
