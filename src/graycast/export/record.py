"""`export.json`: what an export holds and where it comes from, for whoever reads it back."""

from pathlib import Path
from typing import Any

from .. import __version__
from ..dataset import records
from ..dataset.json_text import json_bytes
from ..dataset.reading import Unreadable, read_json
from ..dataset.stored import StoredDataset
from ..errors import DatasetError
from .options import FORMATS, Options

RECORD = "export.json"


class ExportRecord(records.Record):
    """The content of `export.json`; `splits` has the scene ids of each set."""

    format: str
    options: dict[str, Any]
    splits: dict[str, list[int]]
    categories: dict[str, str]
    size_px: list[int]
    depth_scale_mm: float
    holds: list[str]
    fingerprint: str
    graycast: str


def write_record(
    folder: Path, stored: StoredDataset, options: Options, splits: dict[str, list[int]]
) -> ExportRecord:
    """Write `export.json`; its options are those in force."""
    said = {name: getattr(options, name) for name in FORMATS[options.format]}
    record = ExportRecord(
        format=options.format,
        options=said | {"shares": list(options.split.shares), "split_seed": options.split.seed},
        splits=splits,
        categories={str(obj_id): name for obj_id, name in stored.categories.items()},
        size_px=list(stored.size_px),
        depth_scale_mm=stored.depth_scale_mm,
        holds=sorted(stored.holds),
        fingerprint=stored.claim.get("fingerprint", ""),
        graycast=__version__,
    )
    (folder / RECORD).write_bytes(json_bytes(record.model_dump()))
    return record


def read_record(folder: Path) -> ExportRecord:
    """Read `export.json`.

    Raises:
        DatasetError: it is missing or damaged.
    """
    try:
        record = read_json(folder / RECORD, ExportRecord)
    except Unreadable as error:
        raise DatasetError(f"{folder} is not an export of Graycast: {error}") from error
    if record.format not in FORMATS:
        known = ", ".join(FORMATS)
        raise DatasetError(f"{folder}: its format {record.format!r} is none of {known}")
    return record
