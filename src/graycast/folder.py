"""A folder of results: all of its files appear, or none."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import GraycastError


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder to fill in `out`, whose files are moved up into `out` when the block ends well.

    It is made first, so that a path that cannot be written stops a command before its work, not
    after. When the block fails or is stopped, `out` is as it was before, or is not there.

    Raises:
        GraycastError: `out` cannot be written.
    """
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    aside = None
    try:
        out.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=out, prefix=".part-"))
        yield aside
        for file in sorted(aside.iterdir()):
            os.replace(file, out / file.name)
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{out}: cannot be written ({why}): choose a writable folder with space"
        ) from error
    finally:
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)
        with suppress(OSError):  # what holds something stays: the result, or what was there
            for folder in made:
                folder.rmdir()
