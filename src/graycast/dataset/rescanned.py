"""Datasets of others with scanner depth that `graycast rescan` added: their claim and records.

`graycast.json` has `kind: rescan`. Each image has a record, `scan_sl/000012.json` in its scene's
folder, with the SHA-256 of the pictures that the scanner added and with what the scene's JSON files
say of it. What others made is linked or copied, and is not judged.
"""

from pathlib import Path
from typing import Any, Literal

from ..base.errors import DatasetError
from ..base.file_limits import parse_json
from .places import CLAIM
from .records import FormatVersion, Positive, Record
from .safe_reading import Unreadable, read_json

RECORDS = "scan_sl"
SCANNED_POSES = "scene_gt_sl.json"


class RescanClaim(Record):
    """`graycast.json` of rescanned images."""

    format_version: FormatVersion
    kind: Literal["rescan"]
    fingerprint: str
    config: dict[str, Any]
    seed: int
    depth_scale_mm: Positive
    rig: dict[str, Any]
    sources: list[str]
    versions: dict[str, str]

    @property
    def split(self) -> str:
        return str(self.config["split"])

    @property
    def names(self) -> dict[int, str]:
        """Of the objects, by their ids."""
        return {int(obj_id): name for obj_id, name in self.config["names"].items()}


class ImageRecord(Record):
    """The record of one image; `entries` by the names of the scene's JSON files.

    A step of the perfect depth is `perfect_step_mm`, 0 where that has no steps.
    """

    seeds: dict[str, int]
    exposure_s: Positive
    reasons: dict[str, float]
    part_reasons: dict[str, float]
    seconds: float
    perfect_step_mm: float
    entries: dict[str, Any]
    sha256: dict[str, str]


def claim_kind(out: Path) -> str | None:
    """The kind that a folder's `graycast.json` states; None of what `generate` made, or of none."""
    try:
        return parse_json((out / CLAIM).read_bytes()).get("kind")
    except (OSError, ValueError, AttributeError):
        return None


def is_rescanned(out: Path) -> bool:
    """Whether a folder's `graycast.json` says that a rescan wrote it."""
    return claim_kind(out) == "rescan"


def read_rescan(out: Path) -> RescanClaim:
    """The `graycast.json` of a rescan.

    Raises:
        DatasetError: it is damaged, or of another version of Graycast.
    """
    try:
        return read_json(out / CLAIM, RescanClaim)
    except Unreadable as error:
        raise DatasetError(f"{out} is not a rescan that can be read: {error}") from error


def image_record(scene: Path, number: int) -> ImageRecord:
    """The record of one image.

    Raises:
        DatasetError: it is missing or damaged.
    """
    try:
        return read_json(scene / RECORDS / f"{number:06d}.json", ImageRecord)
    except Unreadable as error:
        raise DatasetError(f"{scene}: {error}: run graycast rescan again") from error


def image_records(scene: Path) -> dict[int, ImageRecord]:
    """The records of a scene by image.

    Raises:
        Unreadable: one is damaged.
    """
    paths = sorted((scene / RECORDS).glob("[0-9]*.json"))
    return {int(path.stem): read_json(path, ImageRecord) for path in paths}
