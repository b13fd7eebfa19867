"""Claim and records of foreign datasets to which `graycast rescan` added scanner depth.

`graycast.json` has `kind: rescan`. Each image has a record, `scan_sl/000012.json` in its scene's
folder. It holds the SHA-256 of the pictures that the scanner added, and the image's entries of the
scene's JSON files. The original files are linked or copied and not checked, but a record also has
the SHA-256 of the inputs of its scan, so that a change of the original is noticed.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ..files.json_text import json_bytes
from ..files.places import CLAIM
from ..files.records import FormatVersion, Images, Positive, Record
from ..files.safe_reading import Unreadable, read_json
from ..files.scene_folder import SceneFolder
from ..files.seal import sha256

RECORDS = "scan_sl"
SCANNED_POSES = "scene_gt_sl.json"


class RescanClaim(Record):
    """The content of `graycast.json` for rescanned images."""

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
        """Names of the objects, by id."""
        return {int(obj_id): name for obj_id, name in self.config["names"].items()}


class ImageRecord(Record):
    """The record of one image; `entries` holds its entries of the scene's JSON files, by file name.

    `perfect_step_mm` is the step of the perfect depth, or 0 if it is not quantised. `source` holds
    the SHA-256 of the inputs of the scan; earlier versions did not write it.
    """

    seeds: dict[str, int]
    exposure_s: Positive
    reasons: dict[str, float]
    part_reasons: dict[str, float]
    seconds: float
    perfect_step_mm: float
    entries: dict[str, Any]
    sha256: dict[str, str]
    source: dict[str, str] = Field(default_factory=dict)

    @property
    def reason_px(self) -> dict[str, int]:
        """Number of all pixels with each reason."""
        (image,) = self.entries["scene_gt_coco_sl"]["images"]
        pixels = image["width"] * image["height"]
        return {name: round(share * pixels) for name, share in self.reasons.items()}

    @property
    def part_reason_px(self) -> dict[str, int]:
        """Number of the objects' visible pixels with each reason; empty if no object is visible."""
        pixels = sum(info["px_count_visib"] for info in self.entries["scene_gt_info_sl"])
        return {name: round(share * pixels) for name, share in self.part_reasons.items()}

    @property
    def has_original(self) -> bool:
        """Whether the scan's folder has the original's files: True for datasets in BOP's form.

        For any other layout, `entries` contains the image's `scene_camera`, too.
        """
        return "scene_camera" not in self.entries


def claim_kind(out: Path) -> str | None:
    """Return the kind in a folder's `graycast.json`; None for a generated or missing dataset."""
    try:
        return parse_json((out / CLAIM).read_bytes()).get("kind")
    except (OSError, ValueError, AttributeError):
        return None


def is_rescanned(out: Path) -> bool:
    """Return whether a rescan wrote a folder's `graycast.json`."""
    return claim_kind(out) == "rescan"


def read_rescan(out: Path) -> RescanClaim:
    """Read the `graycast.json` of a rescan.

    Raises:
        DatasetError: the file is damaged, or of another version of Graycast.
    """
    try:
        return read_json(out / CLAIM, RescanClaim)
    except Unreadable as error:
        raise DatasetError(f"{out} is not a rescan that can be read: {error}") from error


def image_record(scene: Path, number: int) -> ImageRecord:
    """Read the record of one image.

    Raises:
        DatasetError: the record is missing or damaged.
    """
    try:
        return read_json(scene / RECORDS / f"{number:06d}.json", ImageRecord)
    except Unreadable as error:
        raise DatasetError(f"{scene}: {error}: run graycast rescan again") from error


def image_records(scene: Path) -> dict[int, ImageRecord]:
    """Read the records of a scene, by image number.

    Raises:
        Unreadable: a record is damaged.
    """
    paths = sorted((scene / RECORDS).glob("[0-9]*.json"))
    return {int(path.stem): read_json(path, ImageRecord) for path in paths}


def original_sums(
    scene: SceneFolder, numbers: Iterable[int], *, poses: bool
) -> dict[int, dict[str, str]]:
    """Return the SHA-256 of each input of an image's scan, by the input's name.

    A missing input has no entry, so that its loss counts as a change.

    Args:
        scene: the original scene in BOP's form, or a folder that links to its files.
        poses: True if the objects' poses are inputs.

    Raises:
        Unreadable: a JSON file is missing or damaged, or a picture cannot be read.
    """
    names = ("scene_camera", "scene_gt") if poses else ("scene_camera",)
    records = {name: scene.record(name, Images[Any]) for name in names}
    sums = {}
    for number in numbers:
        own = {name: entry[number] for name, entry in records.items() if number in entry}
        sums[number] = {name: sha256(json_bytes({"entry": entry})) for name, entry in own.items()}
        color = scene.find_picture("rgb", number) or scene.find_picture("gray", number)
        for name, path in (("depth", scene.find_picture("depth", number)), ("rgb", color)):
            if path is not None:
                try:
                    sums[number][name] = sha256(path.read_bytes())
                except OSError as error:
                    raise Unreadable(f"{path} cannot be read: {error.strerror}") from error
    return sums


def changes(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """Return the names that have different SHA-256, or that only one mapping contains."""
    return sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))
