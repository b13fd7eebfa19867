"""Hand-drawn labels: COCO and LabelMe files as masks with a name.

Coordinates of both count from the corner of the image, half a pixel before this package's own:
pixel (0, 0) covers [0, 1] x [0, 1]. Polygons become masks as pycocotools rasterises them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from pycocotools import mask as coco_mask

from ...base.errors import DatasetError
from ...base.file_limits import check_runs
from ..depth_file import load_json

_REMEDY = "give a COCO file or LabelMe files"


@dataclass(frozen=True, slots=True, kw_only=True)
class Annotation:
    """What somebody drew on one picture: a name and run lengths (compressed) per instance."""

    source: str
    size_px: tuple[int, int]  # height, width
    names: tuple[str, ...]
    masks: tuple[Mapping[str, Any], ...]

    def mask(self, i: int) -> Bool[np.ndarray, "h w"]:
        return coco_mask.decode(dict(self.masks[i])).astype(bool)


def read_annotations(path: Path, stems: Sequence[str]) -> tuple[dict[str, Annotation], list[str]]:
    """The labels of pictures by the stems of their files, and all names in their order.

    Args:
        path: a COCO file, or a folder with one, or a folder of LabelMe files named as the pictures.
        stems: of the pictures.

    Returns:
        COCO's names are ordered by category id, LabelMe's by the alphabet.

    Raises:
        DatasetError: it is neither, or a picture has no annotation, or a shape is not to be used.
    """
    if path.is_dir():
        files = sorted(path.glob("*.json"))
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


def _coco(path: Path) -> tuple[dict[str, Annotation], list[str]]:
    content = load_json(path, _REMEDY)
    try:
        names = {entry["id"]: str(entry["name"]) for entry in content["categories"]}
        images = {entry["id"]: entry for entry in content["images"]}
        stems = [Path(entry["file_name"]).stem for entry in images.values()]
        entries: dict[int, list[dict[str, Any]]] = {image_id: [] for image_id in images}
        for entry in content["annotations"]:
            if entry["image_id"] not in images or entry["category_id"] not in names:
                raise DatasetError(
                    f"{path}: annotation {entry['id']} is of image {entry['image_id']}, category "
                    f"{entry['category_id']}, which the file does not list: export it again"
                )
            entries[entry["image_id"]].append(entry)
        if len(set(stems)) < len(stems):
            twice = next(stem for stem in stems if stems.count(stem) > 1)
            raise DatasetError(f"{path}: two pictures are named {twice}: rename one")
        labels = {
            Path(image["file_name"]).stem: _coco_image(path, image, entries[image_id], names)
            for image_id, image in images.items()
        }
    except (KeyError, TypeError, ValueError) as error:
        why = f"{type(error).__name__} {error}"
        raise DatasetError(f"{path}: is not a COCO file of instances ({why})") from error
    return labels, [names[category_id] for category_id in sorted(names)]


def _coco_image(
    path: Path,
    image: Mapping[str, Any],
    entries: Sequence[Mapping[str, Any]],
    names: Mapping[int, str],
) -> Annotation:
    size = (int(image["height"]), int(image["width"]))
    masks = []
    for entry in entries:
        name = f"{path}: annotation {entry['id']} of {image['file_name']}"
        shape = entry["segmentation"]
        if entry.get("iscrowd") and len(entries) > 1:
            raise DatasetError(f"{name}: is a crowd: draw its instances separately")
        if isinstance(shape, list):
            points = [np.array(p, np.float64).reshape(-1, 2) for p in shape]
            masks.append(_rasterised(points, size, name))
        else:
            masks.append(_run_lengths(shape, size, name))
    return Annotation(
        source=path.name,
        size_px=size,
        names=tuple(names[entry["category_id"]] for entry in entries),
        masks=tuple(masks),
    )


def _run_lengths(shape: Mapping[str, Any], size: tuple[int, int], name: str) -> dict[str, Any]:
    if list(shape["size"]) != list(size):
        raise DatasetError(f"{name}: its mask is {shape['size']}, the picture {list(size)}")
    check_runs(shape, name, DatasetError)
    if isinstance(shape["counts"], list):
        runs = coco_mask.frPyObjects(dict(shape), *size)
    else:
        runs = {"size": list(size), "counts": shape["counts"]}
    return _not_empty(runs, name)


def _labelme(path: Path, content: Mapping[str, Any]) -> Annotation:
    """Shapes with the same label and the same `group_id` are one instance."""
    try:
        size = (int(content["imageHeight"]), int(content["imageWidth"]))
        instances: dict[tuple[str, Any], list[np.ndarray]] = {}
        for i, shape in enumerate(content["shapes"], start=1):
            group = shape.get("group_id")
            key = (str(shape["label"]), ("alone", i) if group is None else group)
            points = _labelme_points(shape, f"{path}: shape {i} ({shape['label']})")
            instances.setdefault(key, []).append(points)
    except (KeyError, TypeError, ValueError) as error:
        why = f"{type(error).__name__} {error}"
        raise DatasetError(f"{path}: is not a LabelMe file ({why})") from error
    masks = [
        _rasterised(points, size, f"{path}: instance {i} ({name})")
        for i, ((name, _), points) in enumerate(instances.items(), start=1)
    ]
    names = tuple(name for name, _ in instances)
    return Annotation(source=path.name, size_px=size, names=names, masks=tuple(masks))


def _labelme_points(shape: Mapping[str, Any], name: str) -> Float[np.ndarray, "_ 2"]:
    points = np.array(shape["points"], np.float64).reshape(-1, 2)
    match shape.get("shape_type", "polygon"):
        case "polygon":
            return points
        case "rectangle":
            (x0, y0), (x1, y1) = points[:2]
            return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        case kind:
            raise DatasetError(f"{name}: is a {kind}: draw instances as polygons or rectangles")


def _rasterised(
    polygons: Sequence[Float[np.ndarray, "_ 2"]], size: tuple[int, int], name: str
) -> dict[str, Any]:
    """Run lengths of the union of polygons."""
    height_px, width_px = size
    for points in polygons:
        if len(points) < 3 or not np.isfinite(points).all():
            raise DatasetError(f"{name}: has {len(points)} corners: a polygon must have at least 3")
        beyond = (points < 0).any(axis=1) | (points > [width_px, height_px]).any(axis=1)
        if beyond.any():
            x, y = points[beyond][0]
            raise DatasetError(
                f"{name}: its corner ({x:g}, {y:g}) lies outside of the picture of {width_px} x "
                f"{height_px} pixels: move the corner, or use the annotation of this picture"
            )
    if not polygons:
        raise DatasetError(f"{name}: has no polygon: draw one, or remove the annotation")
    lists = [points.ravel().tolist() for points in polygons]
    return _not_empty(coco_mask.merge(coco_mask.frPyObjects(lists, height_px, width_px)), name)


def _not_empty(runs: dict[str, Any], name: str) -> dict[str, Any]:
    if coco_mask.area(runs) == 0:
        raise DatasetError(f"{name}: covers no pixel: draw it again, or remove it")
    return runs
