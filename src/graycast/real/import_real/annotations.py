"""Readers of hand-drawn labels in COCO and LabelMe files.

In both formats, the origin is the corner of the image: pixel (0, 0) covers [0, 1] x [0, 1], half a
pixel off this package's convention. pycocotools rasterises polygons. A mask in a LabelMe file is
the picture of a box of pixels; two points give the first and the last pixel of the box.
"""

import base64
import binascii
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from pycocotools import mask as coco_mask

from ...base.errors import DatasetError
from ...base.file_limits import check_runs
from ...base.folder import visible_entries
from ...dataset.files.safe_reading import Unreadable, pixels
from ...dataset.training.foreign import refuse_repeated
from ..depth_file import load_json

_REMEDY = "give a COCO file or LabelMe files"
_CUT_PX = 3.0  # Labelling tools may put corners this far outside the picture.
_MARGIN_PX = math.ceil(_CUT_PX)

Runs = Mapping[str, Any]  # compressed run lengths


@dataclass(frozen=True, slots=True, kw_only=True)
class Annotation:
    """Hand-drawn labels of a picture: a name and a mask (compressed run lengths) per instance.

    `beyond_px` is the largest distance of a polygon's corner outside the picture; else 0.
    """

    source: str
    size_px: tuple[int, int]  # height, width
    names: tuple[str, ...]
    masks: tuple[Runs, ...]
    beyond_px: float

    def mask(self, i: int) -> Bool[np.ndarray, "h w"]:
        return coco_mask.decode(dict(self.masks[i])).astype(bool)


def read_annotations(path: Path, stems: Sequence[str]) -> tuple[dict[str, Annotation], list[str]]:
    """Read the labels of pictures.

    Args:
        path: a COCO file, a folder with one, or a folder of LabelMe files named like the pictures.
            Hidden files are not read, because macOS adds some next to other files.
        stems: the pictures' file stems.

    Returns:
        The labels by file stem, and the names of all objects: COCO's in the order of category ids,
        LabelMe's in alphabetical order.

    Raises:
        DatasetError: there are no such files, a picture has no labels, or a shape is unusable.
    """
    if path.is_dir():
        files = [file for file in visible_entries(path) if file.suffix == ".json"]
        if not files:
            raise DatasetError(f"{path}: has no .json: {_REMEDY}")
        contents = {file: load_json(file, _REMEDY) for file in files}
        whole = [file for file, content in contents.items() if "images" in content]
        if whole and len(files) > 1:
            raise DatasetError(f"{path}: has {whole[0].name} and other files: give the COCO file")
        path = whole[0] if whole else path
    if path.is_dir():
        labels = {file.stem: _labelme(file, content) for file, content in contents.items()}
        names = sorted({name for each in labels.values() for name in each.names})
    else:
        labels, names = _coco(path)
    if missing := [stem for stem in stems if stem not in labels]:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise DatasetError(
            f"{path}: has no annotation of the picture {missing[0]}{more}: annotate every picture "
            "(one without parts has an empty list), or remove it"
        )
    return {stem: labels[stem] for stem in stems}, names


# --- COCO ---------------------------------------------------------------------------------------


def _coco(path: Path) -> tuple[dict[str, Annotation], list[str]]:
    content = load_json(path, _REMEDY)
    try:
        refuse_repeated(content, str(path))
        names = {entry["id"]: str(entry["name"]) for entry in content["categories"]}
        images = {entry["id"]: entry for entry in content["images"]}
        stem_of = {image_id: _stem(entry["file_name"]) for image_id, entry in images.items()}
        entries: dict[int, list[dict[str, Any]]] = {image_id: [] for image_id in images}
        for entry in content["annotations"]:
            if entry["image_id"] not in images or entry["category_id"] not in names:
                raise DatasetError(
                    f"{path}: annotation {entry['id']} is of image {entry['image_id']}, category "
                    f"{entry['category_id']}, which the file does not list: export it again"
                )
            entries[entry["image_id"]].append(entry)
        stems = list(stem_of.values())
        if len(set(stems)) < len(stems):
            twice = next(stem for stem in stems if stems.count(stem) > 1)
            raise DatasetError(f"{path}: two pictures are named {twice}: rename one")
        labels = {
            stem_of[image_id]: _coco_image(path, image, entries[image_id], names)
            for image_id, image in images.items()
        }
    except (KeyError, TypeError, ValueError) as error:
        why = f"{type(error).__name__} {error}"
        raise DatasetError(f"{path}: is not a COCO file of instances ({why})") from error
    return labels, [names[category_id] for category_id in sorted(names)]


def _stem(file_name: str) -> str:
    """Return a file name without ending and folders, which slashes or backslashes may separate."""
    return Path(file_name.replace("\\", "/")).stem


def _coco_image(
    path: Path,
    image: Mapping[str, Any],
    entries: Sequence[Mapping[str, Any]],
    names: Mapping[int, str],
) -> Annotation:
    size = (int(image["height"]), int(image["width"]))
    masks: dict[str, Runs] = {}
    beyond_px = 0.0
    for k, entry in enumerate(entries, start=1):
        name = f"{path}: annotation {entry['id']} of {image['file_name']}"
        shape = entry.get("segmentation")
        if entry.get("iscrowd") and len(entries) > 1:
            raise DatasetError(f"{name}: is a crowd: draw its instances separately")
        if not shape:
            raise DatasetError(
                f"{name}: has no polygon and no mask, and its box alone is not enough: draw the "
                "outline of the instance, or remove the annotation"
            )
        if isinstance(shape, list):
            polygons = [
                _corners(numbers, f"{name}: polygon {i}") for i, numbers in enumerate(shape, 1)
            ]
            beyond_px = max(beyond_px, *(_beyond_px(points, size, name) for points in polygons))
            runs = _united([_rasterised(points, size) for points in polygons], name)
        else:
            runs = _run_lengths(shape, size, name)
        masks[f"annotation {entry['id']} ({k} of {image['file_name']})"] = runs
    _refuse_alike(masks, path)
    return Annotation(
        source=path.name,
        size_px=size,
        names=tuple(names[entry["category_id"]] for entry in entries),
        masks=tuple(masks.values()),
        beyond_px=beyond_px,
    )


def _run_lengths(shape: Mapping[str, Any], size: tuple[int, int], name: str) -> Runs:
    if list(shape["size"]) != list(size):
        raise DatasetError(f"{name}: its mask is {shape['size']}, the picture {list(size)}")
    check_runs(shape, name, DatasetError)
    if isinstance(shape["counts"], list):
        runs = coco_mask.frPyObjects(dict(shape), *size)
    else:
        runs = {"size": list(size), "counts": shape["counts"].encode("ascii")}
    return _united([runs], name)


# --- LabelMe ------------------------------------------------------------------------------------


def _labelme(path: Path, content: Mapping[str, Any]) -> Annotation:
    """Read a LabelMe file; shapes with the same label and `group_id` are one instance."""
    beyond_px = 0.0
    try:
        size = (int(content["imageHeight"]), int(content["imageWidth"]))
        instances: dict[tuple[str, Any], list[Runs]] = {}
        for i, shape in enumerate(content["shapes"], start=1):
            name = f"{path}: shape {i} ({shape['label']})"
            group = shape.get("group_id")
            key = (str(shape["label"]), ("alone", i) if group is None else group)
            if shape.get("shape_type") == "mask":
                runs = _labelme_mask(shape, size, name)
            else:
                points = _labelme_outline(shape, name)
                beyond_px = max(beyond_px, _beyond_px(points, size, name))
                runs = _rasterised(points, size)
            instances.setdefault(key, []).append(runs)
    except (KeyError, TypeError, ValueError) as error:
        why = f"{type(error).__name__} {error}"
        raise DatasetError(f"{path}: is not a LabelMe file ({why})") from error
    masks = {
        f"instance {i} ({name})": _united(runs, f"{path}: instance {i} ({name})")
        for i, ((name, _), runs) in enumerate(instances.items(), start=1)
    }
    _refuse_alike(masks, path)
    return Annotation(
        source=path.name,
        size_px=size,
        names=tuple(name for name, _ in instances),
        masks=tuple(masks.values()),
        beyond_px=beyond_px,
    )


def _labelme_outline(shape: Mapping[str, Any], name: str) -> Float[np.ndarray, "_ 2"]:
    numbers = [number for point in shape["points"] for number in point]
    match shape.get("shape_type", "polygon"):
        case "polygon":
            return _corners(numbers, name)
        case "rectangle":
            x0, y0, x1, y1 = numbers
            return _corners([x0, y0, x1, y0, x1, y1, x0, y1], name)
        case kind:
            raise DatasetError(
                f"{name}: is a {kind}: draw instances as polygons, rectangles or masks"
            )


def _labelme_mask(shape: Mapping[str, Any], size: tuple[int, int], name: str) -> Runs:
    """Return the run lengths of a PNG mask of the box between two points, both included."""
    try:
        content = base64.b64decode(shape["mask"], validate=True)
        inside = pixels(content, "its mask") > 0
    except (binascii.Error, Unreadable) as error:
        raise DatasetError(f"{name}: its mask is damaged ({error}): draw it again") from error
    (left, top), (right, bottom) = np.array(shape["points"], np.float64).astype(int).tolist()
    if inside.shape != (bottom - top + 1, right - left + 1):
        raise DatasetError(
            f"{name}: its mask is {inside.shape}, and its points span "
            f"{(bottom - top + 1, right - left + 1)} rows and columns: draw it again"
        )
    if min(left, top) < 0 or right >= size[1] or bottom >= size[0]:
        raise DatasetError(
            f"{name}: its mask from ({left}, {top}) to ({right}, {bottom}) lies outside of the "
            f"picture of {size[1]} x {size[0]} pixels: use the annotation of this picture"
        )
    whole = np.zeros(size, np.uint8, order="F")
    whole[top : bottom + 1, left : right + 1] = inside
    return coco_mask.encode(whole)


# --- shared by both formats -----------------------------------------------------------------------


def _corners(numbers: Any, name: str) -> Float[np.ndarray, "_ 2"]:
    """Return the corners of a polygon from a list of x, y, x, y ...

    Raises:
        DatasetError: the list does not contain the numbers of at least three corners.
    """
    if not isinstance(numbers, list):
        raise DatasetError(f"{name}: is {numbers!r}: a polygon is a list of x, y, x, y ...")
    if len(numbers) % 2:
        raise DatasetError(f"{name}: has {len(numbers)} numbers, not x and y of each corner")
    if len(numbers) < 6:
        raise DatasetError(
            f"{name}: has {len(numbers) // 2} corners: a polygon must have at least 3"
        )
    for i, value in enumerate(numbers):
        if type(value) not in (int, float) or not math.isfinite(value):
            raise DatasetError(
                f"{name}: corner {i // 2 + 1} is not a number ({'xy'[i % 2]} is {value}): draw the "
                "instance again"
            )
    return np.array(numbers, np.float64).reshape(-1, 2)


def _beyond_px(points: Float[np.ndarray, "_ 2"], size: tuple[int, int], name: str) -> float:
    """Return the largest distance [px] of a corner outside the picture, or 0 if all are inside.

    Raises:
        DatasetError: a corner is so far outside that the polygon must belong to another picture.
    """
    height_px, width_px = size
    beyond_px = np.maximum(-points, points - [width_px, height_px]).max(axis=1)
    if beyond_px.max() > _CUT_PX:
        x, y = points[beyond_px.argmax()]
        raise DatasetError(
            f"{name}: its corner ({x:g}, {y:g}) lies outside of the picture of {width_px} x "
            f"{height_px} pixels: move the corner, or use the annotation of this picture"
        )
    return max(0.0, float(beyond_px.max()))


def _rasterised(points: Float[np.ndarray, "_ 2"], size: tuple[int, int]) -> Runs:
    """Return the run lengths of a polygon, cut at the border of the picture.

    pycocotools misplaces corners with negative coordinates, so the picture gets a margin first.
    """
    inside = slice(_MARGIN_PX, -_MARGIN_PX)
    numbers = [(points + _MARGIN_PX).ravel().tolist()]
    (runs,) = coco_mask.frPyObjects(numbers, *(edge + 2 * _MARGIN_PX for edge in size))
    return coco_mask.encode(np.asfortranarray(coco_mask.decode(runs)[inside, inside]))


def _united(pieces: Sequence[Runs], name: str) -> Runs:
    """Return the union of masks as run lengths; refuse an empty union."""
    runs = coco_mask.merge([dict(piece) for piece in pieces])
    if coco_mask.area(runs) == 0:
        raise DatasetError(f"{name}: covers no pixel: draw it again, or remove it")
    return runs


def _refuse_alike(masks: Mapping[str, Runs], path: Path) -> None:
    """Refuse a picture in which two instances have the same mask, because one is a duplicate."""
    first: dict[bytes, str] = {}
    for name, runs in masks.items():
        if (other := first.setdefault(runs["counts"], name)) != name:
            raise DatasetError(f"{path}: {name} has the same mask as {other}: remove one of them")
