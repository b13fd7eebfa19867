"""Read a scene in BOP's form, from Graycast or another program. Only this module knows file names.

A JSON file is named after its content and has an entry for each image's number. Each kind of
picture has a folder. A picture is named by the image's number, a mask also by the instance's
number. Names end in a camera type, except for the first camera: `depth_sl` is the scanner's depth.
A scanner's name precedes the camera type: `rgb_left`, `depth_left_sl`. Graycast writes PNGs.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ...base.array_types import Bool
from ...base.errors import DatasetError
from .records import Count, Distortion, Images, Matrix3, Positive, Vector
from .safe_reading import Form, Unreadable, read_json, read_mask, read_picture, read_png, record_as

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
SCANNER = "_sl"  # Graycast's own datasets add this camera type.
OWN_PICTURES = {
    "rgb": np.uint8,
    "depth": np.uint16,
    "gray_sl": np.uint8,
    "depth_sl": np.uint16,
    "reason_sl": np.uint8,
    "modulation_sl": np.uint16,
}
OWN_OPTIONS = {"pwrong_sl": np.uint8}  # Pictures that scenes have if the scanner estimates them.

R = TypeVar("R")


def scene_folders(path: Path, files: str = "scene_gt.json") -> list[Path]:
    """Return the scenes of a split: folders that have a number as a name and contain the file."""
    folders = {file.parent for file in path.glob(f"[0-9]*/{files}")}
    return sorted(folder for folder in folders if folder.name.isdecimal())


def dead_links(folder: Path, places: Iterable[Path] | None = None) -> Iterator[str]:
    """Yield a message for each folder that links point to but whose files are missing.

    Args:
        folder: a scene, or the dataset's own folder.
        places: the entries to check; None checks all in the folder.
    """
    gone: dict[Path, list[str]] = {}
    for place in sorted(folder.iterdir() if places is None else places):
        if place.is_symlink() and not place.exists():
            gone.setdefault(place.readlink().parent, []).append(str(place.relative_to(folder)))
    for origin, names in gone.items():
        yield (
            f"{folder}: {', '.join(names)}: the original in {origin} is gone: put it back, or link "
            "it there (graycast rescan --copy makes a result that needs no original)"
        )


def of_sensor(name: str, sensor: str) -> str:
    """Return the name of a scanner's file or folder, such as `depth_left_sl` for `depth_sl`.

    If the scanner has no name, `name` is returned unchanged.
    """
    if not sensor:
        return name
    plain = name.removesuffix(SCANNER)
    return f"{plain}_{sensor}{name[len(plain) :]}"


def picture_name(kind: str, number: int, sensor: str = "") -> str:
    """Return the path of an image's PNG inside its scene's folder."""
    return f"{of_sensor(kind, sensor)}/{number:06d}.png"


def own_form(kind: str, size_px: tuple[int, int]) -> tuple[tuple[int, ...], type]:
    """Return the shape and type of a picture in our datasets; only `rgb` has three channels."""
    return (*size_px, 3)[: 3 if kind == "rgb" else 2], (OWN_PICTURES | OWN_OPTIONS)[kind]


@final
@dataclass(frozen=True, slots=True)
class SceneFolder:
    """The files of a scene, each read and checked on demand.

    Reading raises Unreadable if a file is missing, damaged or not of the required form. `sensor` is
    the name of one of several scanners.
    """

    path: Path
    sensor: str = ""

    def record(self, name: str, form: Form[R]) -> R:
        """Read a JSON file as a record of the given form."""
        return read_json(self.path / f"{of_sensor(name, self.sensor)}.json", form)

    def of_image(self, name: str, number: int, form: Form[R]) -> R:
        """Return the entry of one image in a JSON file; other entries are not checked."""
        return record_as(self._entry(name, number), form, self._where(name, number))

    def of_instances(self, name: str, number: int, form: Form[R]) -> list[R]:
        """Return the entries of an image's instances in a JSON file."""
        where, entry = self._where(name, number), self._entry(name, number)
        if not isinstance(entry, list):
            raise Unreadable(f"{where} must have a list with an entry for each of its instances")
        return [record_as(one, form, f"{where}, instance {i}") for i, one in enumerate(entry)]

    def find_picture(
        self, kind: str, number: int, endings: tuple[str, ...] = PICTURES
    ) -> Path | None:
        """Return the path of a picture of any format; None if the picture does not exist.

        BOP's names have six digits; names with fewer or more digits are found, too.

        Raises:
            Unreadable: two files are pictures with this number.
            DatasetError: the picture, or its folder, is a link to a missing file.
        """
        folder = self._of(kind)
        files = [folder / f"{number:06d}{ending}" for ending in endings]
        for problem in dead_links(self.path, (folder, *files)):
            raise DatasetError(problem)
        if file := next((file for file in files if file.is_file()), None):
            return file
        others = [file for file in folder.glob(f"*{number}.*") if file.suffix in endings
                  and re.fullmatch(r"\d+", file.stem) and int(file.stem) == number]  # fmt: skip
        if len(others) > 1:
            names = " and ".join(sorted(file.name for file in others))
            raise Unreadable(f"{folder.name}: {names} are both image {number}: remove one")
        return others[0] if others else None

    def picture(self, kind: str, number: int) -> np.ndarray | None:
        """Return a picture of any format as stored, colours in OpenCV's order; None if missing."""
        path = self.find_picture(kind, number)
        return None if path is None else read_picture(path)

    def optional_pictures(self) -> tuple[str, ...]:
        """Return the kinds of `OWN_OPTIONS` that the scene has."""
        return tuple(kind for kind in OWN_OPTIONS if self._of(kind).is_dir())

    def png_path(self, kind: str, number: int = 0) -> Path:
        return self._of(kind) / f"{number:06d}.png"

    def png(self, kind: str, number: int = 0) -> np.ndarray:
        """Read a picture that must exist as a PNG."""
        return read_png(self.png_path(kind, number))

    def mask_path(self, kind: str, instance: int, number: int = 0) -> Path:
        """Return the path of a mask; `kind` is `mask` (with hidden pixels) or `mask_visib`."""
        return self._of(kind) / f"{number:06d}_{instance:06d}.png"

    def mask(self, kind: str, instance: int, number: int = 0) -> Bool[np.ndarray, "h w"]:
        return read_mask(self.mask_path(kind, instance, number))

    def _entry(self, name: str, number: int) -> Any:
        entries = self.record(name, Images[Any])
        if number not in entries:
            raise Unreadable(f"{of_sensor(name, self.sensor)}.json says nothing of image {number}")
        return entries[number]

    def _where(self, name: str, number: int) -> str:
        return f"{of_sensor(name, self.sensor)}.json: image {number}"

    def _of(self, kind: str) -> Path:
        return self.path / of_sensor(kind, self.sensor)


class _Promised(BaseModel):
    """Keys that every dataset in BOP's form has; other keys are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class AnyCamera(_Promised):
    """One image in the `scene_camera.json` of a dataset that may lack the depth scale."""

    cam_K: Matrix3
    distortion: Distortion = [0.0] * 5  # Only Graycast's datasets have this key.


class AnyView(AnyCamera):
    """One image in `scene_camera.json`."""

    depth_scale: Positive


class AnyScanner(_Promised):
    """One image in `scene_sl.json`: the number of each reason for missing depth."""

    reasons: dict[str, int] = {}


class AnyPose(_Promised):
    """One instance in `scene_gt.json`."""

    obj_id: Annotated[int, Field(strict=True)]
    cam_R_m2c: Matrix3
    cam_t_m2c: Vector


class AnyInfo(_Promised):
    """One instance in `scene_gt_info.json`."""

    px_count_visib: Count
    visib_fract: float
