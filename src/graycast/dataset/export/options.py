"""The options of an export, and which format accepts which option."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from ...base.errors import GraycastError
from ..read.stored import StoredDataset
from .split import Split

Value = TypeVar("Value")

_CHOICES = {
    "image": ("rgb", "gray"),
    "depth": ("perfect", "scanner", "both", "none"),
    "labels": ("segments", "boxes"),
    "cloud": ("ply", "pcd"),
    "pixel_origin": ("centre", "corner"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One export format.

    `writer` names a module of this folder and its function that writes one set of the split. It
    receives what the module's function `content` returned for each picture in a worker process. The
    module's function `write_rest`, if there is one, writes the files of the dataset as a whole.
    `reader` names a module of `dataset/training` and its function that opens one set's examples;
    None for a format that programs do not train from. `options` are the format's options and their
    defaults, `depths` the allowed depths, and `needs` what a dataset must contain.
    """

    writer: str
    reader: str | None
    options: Mapping[str, Any]
    depths: tuple[str, ...] = _CHOICES["depth"]
    needs: tuple[str, ...] = ()


FORMATS: Mapping[str, Format] = {
    "coco": Format(
        writer="coco.write_split",
        reader="picture_folders.open_coco",
        options={
            "image": "rgb", "depth": "none", "polygons": False, "link": False, "min_visibility": 0.0
        },
        needs=("masks", "pictures")
    ),
    "yolo": Format(
        writer="yolo.write_split",
        reader="picture_folders.open_yolo",
        options={"image": "rgb", "labels": "segments", "link": False, "min_visibility": 0.0},
        needs=("masks", "pictures")
    ),
    "bop-webdataset": Format(
        writer="bop_shards.write_split",
        reader="shard_examples.open_bop_shards",
        options={
            "image": "rgb", "depth": "perfect", "shard_scenes": 1000, "pixel_origin": "centre"
        },
        depths=("perfect", "scanner", "none")
    ),
    "parquet": Format(
        writer="parquet.write_split",
        reader="parquet_examples.open_parquet",
        options={"image": "rgb", "depth": "both", "shard_scenes": 500, "min_visibility": 0.0}
    ),
    "clouds": Format(
        writer="clouds.write_split",
        reader=None,
        options={"image": "rgb", "depth": "both", "cloud": "ply", "organised": False}
    ),
    "ros2bag": Format(
        writer="ros_bag.write_sqlite3", reader=None, options={"image": "rgb", "depth": "both"}
    ),
    "mcap": Format(
        writer="ros_bag.write_mcap", reader=None, options={"image": "rgb", "depth": "both"}
    ),
    "rerun": Format(
        writer="rerun_log.write_split", reader=None, options={"image": "rgb", "depth": "both"}
    ),
    "foundationpose": Format(
        writer="pose_demos.write_split",
        reader=None,
        options={"image": "rgb", "depth": "scanner"},
        depths=("perfect", "scanner"),
        needs=("masks", "pictures", "depth")
    )
}  # fmt: skip
_FORMER = ("bop-imagewise", "webdataset")
_PICTURE = {"rgb": "rgb", "gray": "gray_sl"}
DEPTHS = {
    "perfect": ("depth",), "scanner": ("depth_sl",), "both": ("depth", "depth_sl"), "none": ()
}  # fmt: skip


def no_format(name: str) -> str:
    """Return the error message for an unknown format; it names the formats to use."""
    if name in _FORMER:
        return (
            f"the format {name} is no longer written or read: export as bop-webdataset, or as "
            "parquet for both depths in one file"
        )
    return f"format is {name!r}: choose one of {', '.join(FORMATS)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of an export; None means the default of the format.

    Attributes:
        format: one of `FORMATS`.
        split: the division of the scenes into train, val and test.
        image: the picture: `rgb`, the colour camera's, or `gray`, the scanner's white frame.
        depth: `perfect`, `scanner`, `both` or `none`.
        polygons: COCO's masks as polygons instead of run lengths.
        labels: YOLO's rows as `segments` or as `boxes`.
        cloud: `ply` or `pcd`.
        organised: clouds with a point for every pixel, NaN if the pixel has no depth.
        shard_scenes: largest number of scenes in one file.
        pixel_origin: the point of the top-left pixel that is (0, 0) in BOP's cameras: its
            `centre`, as BOP defines it, or its `corner`, as bop_toolkit's renderers assume.
        link: make hard links to the dataset's pictures instead of copies.
        min_visibility: leave out instances whose visible fraction is smaller.
    """

    format: str
    split: Split = field(default_factory=Split)
    image: str | None = None
    depth: str | None = None
    polygons: bool | None = None
    labels: str | None = None
    cloud: str | None = None
    organised: bool | None = None
    shard_scenes: int | None = None
    link: bool | None = None
    pixel_origin: str | None = None
    min_visibility: float | None = None

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise GraycastError(no_format(self.format))
        for name in self.own_names():
            if name not in FORMATS[self.format].options:
                raise GraycastError(
                    f"{self.format} has no option {name}: remove it; the options are "
                    f"{', '.join(FORMATS[self.format].options)}"
                )
        for name, allowed in _CHOICES.items():
            if name == "depth":
                allowed = FORMATS[self.format].depths
            if (value := getattr(self, name)) not in (None, *allowed):
                raise GraycastError(f"{name} is {value!r}: choose one of {', '.join(allowed)}")
        if self.shard_scenes is not None and self.shard_scenes < 1:
            raise GraycastError(
                f"shard_scenes is {self.shard_scenes}: give at least 1 scene per file"
            )
        if self.min_visibility is not None and not 0 <= self.min_visibility <= 1:
            raise GraycastError(
                f"min_visibility is {self.min_visibility}: give a share from 0 to 1"
            )

    def own_names(self) -> list[str]:
        """Return the names of the options that the user set."""
        names = [each.name for each in fields(self) if each.name not in ("format", "split")]
        return [name for name in names if getattr(self, name) is not None]

    def resolved(self, stored: StoredDataset) -> "Options":
        """Return these options with the format's defaults, limited to what the dataset contains.

        Raises:
            GraycastError: the dataset lacks what the user requested.
        """
        settings = dict(FORMATS[self.format].options) | {
            name: getattr(self, name) for name in self.own_names()
        }
        holds = stored.holds
        if "image" in settings and _PICTURE[settings["image"]] not in holds:
            self._refuse("image", settings["image"], stored)
            settings["image"] = "gray" if "gray_sl" in holds else None
        if not set(DEPTHS[settings.get("depth", "none")]) <= holds:
            self._refuse("depth", settings["depth"], stored)
            known = {"depth": "perfect", "depth_sl": "scanner"}
            settings["depth"] = next((known[n] for n in known if n in holds), "none")
        depth = settings.get("depth", "none") != "none"
        there = {"masks": "masks" in holds, "pictures": settings["image"], "depth": depth}
        for what in FORMATS[self.format].needs:
            if not there[what]:
                raise GraycastError(
                    f"{stored.folder}: has no {what}, which the format {self.format} needs"
                )
        return replace(self, **settings)

    def _refuse(self, name: str, value: str, stored: StoredDataset) -> None:
        if getattr(self, name) is not None:
            kinds = ", ".join(sorted(stored.holds))
            raise GraycastError(f"{stored.folder}: has no {value} {name}; it holds {kinds}")

    @property
    def shift_px(self) -> float:
        """Offset that is added to the dataset's principal point, which refers to pixel centres."""
        return 0.5 if self.pixel_origin == "corner" else 0.0

    @property
    def picture(self) -> str | None:
        """Folder of the dataset's pictures; None if there are no pictures."""
        return _PICTURE[self.image] if self.image is not None else None

    @property
    def depths(self) -> tuple[str, ...]:
        """Folders of the dataset's depth pictures."""
        return DEPTHS[self.depth or "none"]


def settled(value: Value | None) -> Value:
    """Return the value of an option that `Options.resolved` has set.

    Raises:
        ValueError: the option is None.
    """
    if value is None:
        raise ValueError("an option is open: resolve the options first")
    return value
