"""Results of a design study on disk: a folder for each setting, with a file for each heap.

design.json           figures of all settings, and the recommendation
table.md, table.csv   the same figures as tables
pareto.png, missing.png
settings/NAME/
    setting.json      all values that the figures depend on; runs with other values are refused
    000.json          figures of one heap
    picture.png       the fates of the surface points of the first heap
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...base.errors import DatasetError, GraycastError
from ...base.file_limits import parse_json
from ...base.folder import claimed_folder, refuse_foreign, write_whole
from ...dataset.files.json_text import json_bytes, plain
from ...dataset.write.claim import difference
from .setting import Placed
from .study import DesignSpec

SETTINGS, SETTING, PICTURE = "settings", "setting.json", "picture.png"
_LOCK = ".lock"


def heap_file(layout: int) -> str:
    return f"{layout:03d}.json"


def heap_files(
    name: str, layout: int, figures: Mapping[str, Any], picture: bytes | None
) -> list[tuple[str, bytes]]:
    """Return the files of a setting's scan of a heap as (path, content), with the figures last."""
    files = [] if picture is None else [(f"{name}/{PICTURE}", picture)]
    return [*files, (f"{name}/{heap_file(layout)}", json_bytes(figures))]


def is_finished(out: Path, name: str, layout: int) -> bool:
    return (out / SETTINGS / name / heap_file(layout)).exists()


def write_heap(out: Path, files: Sequence[tuple[str, bytes]]) -> None:
    """Write a heap's files; the figures are written last because they mark the heap as complete.

    Raises:
        GraycastError: the files cannot be written.
    """
    for name, content in files:
        write_whole(out / SETTINGS / name, content)


def claim_setting(out: Path, placed: Placed, described: Mapping[str, Any]) -> None:
    """Create a setting's folder, or check that an existing folder has the same values.

    Raises:
        DatasetError: the folder was measured with other values; the message names the difference.
        GraycastError: the folder cannot be written.
    """
    folder = out / SETTINGS / placed.setting.name
    path = folder / SETTING
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, json_bytes(described))
        return
    try:
        earlier = parse_json(path.read_bytes())
    except ValueError as error:
        raise DatasetError(f"{path} cannot be read ({error}): remove its folder") from error
    if where := difference(earlier, plain(described), ""):
        raise DatasetError(
            f"{folder} was measured with other values, which differ in "
            f"{where.removeprefix('.')}: choose another folder, or remove this one"
        )


@contextmanager
def open_design(out: Path) -> Iterator[None]:
    """Create or resume a study's folder, locked against other runs.

    Raises:
        GraycastError: the path is a file, or the folder has other content, is locked or read-only.
    """
    refuse_foreign(out, SETTINGS)
    with claimed_folder(out, SETTINGS, _LOCK):
        yield


def read_heaps(out: Path, name: str, spec: DesignSpec) -> list[dict[str, Any] | None]:
    """Return a setting's figures for each heap; None for heaps without figures.

    Raises:
        GraycastError: a file is damaged.
    """
    heaps: list[dict[str, Any] | None] = []
    for layout in range(spec.layouts):
        path = out / SETTINGS / name / heap_file(layout)
        try:
            heaps.append(parse_json(path.read_bytes()) if path.exists() else None)
        except ValueError as error:
            raise GraycastError(f"{path}: cannot be read ({error}): remove this file") from error
    return heaps
