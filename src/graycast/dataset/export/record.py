"""`export.json`: the content and the origin of an export, for the programs that read it."""

from pathlib import Path
from typing import Any

from ...base.errors import DatasetError
from ...base.version import __version__
from ..files import records
from ..files.json_text import json_bytes
from ..files.safe_reading import Unreadable, read_json
from ..read.stored import StoredDataset
from .options import FORMATS, Options, no_format

RECORD = "export.json"


class ExportedPicture(records.Record):
    """A picture that each scene has; `sensor` is the scanner's name, or empty."""

    sensor: str
    image: int
    size_px: list[int]


class ExportRecord(records.Record):
    """The content of `export.json`; `splits` holds the numbers of the pictures of each set.

    If scenes have several pictures, `pictures` lists them: picture n belongs to scene
    n // len(pictures) and has the index n % len(pictures) there.
    """

    format: str
    options: dict[str, Any]
    splits: dict[str, list[int]]
    categories: dict[str, str]
    size_px: list[int]
    depth_scale_mm: float
    holds: list[str]
    fingerprint: str
    graycast: str
    pictures: tuple[ExportedPicture, ...] = ()

    def place(self, image_id: int) -> tuple[int, int]:
        """Return the scene of a picture, and the picture's index in that scene."""
        return divmod(image_id, max(len(self.pictures), 1))

    def image(self, image_id: int) -> tuple[int, str, int]:
        """Return a picture's scene, its scanner, and its number among that scanner's images."""
        scene_id, place = self.place(image_id)
        if not self.pictures:
            return scene_id, "", 0
        return scene_id, self.pictures[place].sensor, self.pictures[place].image

    def size_of(self, image_id: int) -> tuple[int, int]:
        """Return the height and width of a picture."""
        here = self.pictures[self.place(image_id)[1]].size_px if self.pictures else self.size_px
        return here[0], here[1]


def write_record(
    folder: Path, stored: StoredDataset, options: Options, splits: dict[str, list[int]]
) -> ExportRecord:
    """Write `export.json` with the resolved options."""
    settings = {name: getattr(options, name) for name in FORMATS[options.format].options}
    record = ExportRecord(
        format=options.format,
        options=settings | {"shares": list(options.split.shares), "split_seed": options.split.seed},
        splits=splits,
        categories={str(obj_id): name for obj_id, name in stored.categories.items()},
        size_px=list(stored.size_px),
        depth_scale_mm=stored.depth_scale_mm,
        holds=sorted(stored.holds),
        fingerprint=stored.claim.get("fingerprint", ""),
        graycast=__version__,
        pictures=tuple(
            ExportedPicture(sensor=sensor, image=image, size_px=list(stored.sizes_px[sensor]))
            for sensor, image in (stored.images if len(stored.images) > 1 else ())
        ),
    )
    (folder / RECORD).write_bytes(json_bytes(record.model_dump(exclude_defaults=True)))
    return record


def read_record(folder: Path) -> ExportRecord:
    """Read `export.json`.

    Raises:
        DatasetError: the file is missing or damaged.
    """
    try:
        record = read_json(folder / RECORD, ExportRecord)
    except Unreadable as error:
        raise DatasetError(f"{folder} is not an export of Graycast: {error}") from error
    if record.format not in FORMATS:
        raise DatasetError(f"{folder}: {no_format(record.format)}")
    return record
