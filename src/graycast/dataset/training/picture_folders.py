"""Read examples from COCO and YOLO exports: folders of pictures with text files."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pycocotools import mask as coco_mask

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ...base.folder import leads_out
from ..export.options import DEPTHS
from ..export.record import ExportRecord
from ..files.safe_reading import Unreadable, read_png
from ..read.example import Example, pose_m
from .from_bytes import DEPTH_FIELDS, boxes, compressed, depth_m, image_fields, masks


def open_coco(
    folder: Path, split: str, record: ExportRecord, scene_ids: Sequence[int]
) -> Callable[[int], Example]:
    """Read the annotations once; pictures are read on demand."""
    path = folder / "annotations" / f"instances_{split}.json"
    try:
        content = parse_json(path.read_bytes())
        image = {entry["id"]: entry for entry in content["images"]}
        entries: dict[int, list[dict[str, Any]]] = defaultdict(list)
        for entry in content["annotations"]:
            entries[entry["image_id"]].append(entry)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path}: cannot be read ({error}): export again") from error
    if missing := sorted(set(scene_ids) - set(image)):
        raise DatasetError(f"{path}: has no image {missing[0]}, export.json has: export again")
    return partial(_coco_example, folder, split, record, image, dict(entries))


def _coco_example(
    folder: Path,
    split: str,
    record: ExportRecord,
    images: dict[int, dict[str, Any]],
    entries: dict[int, list[dict[str, Any]]],
    scene_id: int,
) -> Example:
    image, labels = images[scene_id], entries.get(scene_id, [])
    size, name = (image["height"], image["width"]), f"{folder}: image {scene_id}"
    runs = [compressed(entry["segmentation"], size) for entry in labels]
    fields = _pictures(folder, f"{split}/{image['file_name']}", record, image["depth_scale"])
    posed = all("cam_R_m2c" in entry for entry in labels) and "poses" in record.holds
    pose = [pose_m(e["cam_R_m2c"], e["cam_t_m2c"]) for e in labels] if posed else []
    rated = "shares" in record.holds
    return Example(
        scene_id=scene_id,
        K=np.array(image["cam_K"], float).reshape(3, 3),
        distortion=tuple(image["distortion"]),
        instance=np.array([entry["gt_id"] for entry in labels], np.int64),
        obj_id=np.array([entry["category_id"] for entry in labels], np.int64),
        mask=masks(runs, size, name),
        box_px=np.array([entry["bbox"] for entry in labels], np.float32).reshape(-1, 4),
        T_cam_part=np.array(pose, float).reshape(-1, 4, 4) if posed else None,
        visib_fract=np.array([entry["visib_fract"] for entry in labels], float) if rated else None,
        **fields,
    )


def open_yolo(
    folder: Path, split: str, record: ExportRecord, scene_ids: Sequence[int]
) -> Callable[[int], Example]:
    """Return a reader of pictures, classes, boxes and polygons, which are all that YOLO stores."""
    return partial(_yolo_example, folder, split, record)


def _yolo_example(folder: Path, split: str, record: ExportRecord, scene_id: int) -> Example:
    path = folder / "labels" / split / f"{scene_id:06d}.txt"
    height_px, width_px = record.size_of(scene_id)
    try:
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
        shape = [np.array(row[1:], float).reshape(-1, 2) for row in rows]
        class_index = [int(row[0]) for row in rows]
    except (OSError, ValueError, IndexError) as error:
        raise DatasetError(f"{path}: cannot be read ({error}): export again") from error
    corner_px = [np.rint(xy * [width_px, height_px] * 2) / 2 for xy in shape]
    obj_ids = [int(obj_id) for obj_id in record.categories]
    mask = None
    if record.options["labels"] == "segments":
        size = (height_px, width_px)
        runs = [coco_mask.frPyObjects([xy.ravel().tolist()], *size)[0] for xy in corner_px]
        mask = masks(runs, size, str(path))
        box_px = boxes(mask)
    else:
        middle_size = np.array(corner_px, float).reshape(-1, 4)
        corner = middle_size[:, :2] - middle_size[:, 2:] / 2
        box_px = np.hstack([corner, middle_size[:, 2:]]).astype(np.float32)
    return Example(
        scene_id=scene_id,
        obj_id=np.array([obj_ids[index] for index in class_index], np.int64),
        mask=mask,
        box_px=box_px,
        **_pictures(folder, f"{split}/{scene_id:06d}.png", record, record.depth_scale_mm),
    )


def _pictures(folder: Path, name: str, record: ExportRecord, scale_mm: float) -> dict[str, Any]:
    """Return the picture and the depths that an export contains."""
    if leads_out(name):
        raise DatasetError(f"{folder}: picture {name} leads out of the folder: export again")
    image = folder / "images" / name
    fields: dict[str, Any] = image_fields(record.options["image"], _read(image), str(image))
    for depth in DEPTHS[record.options.get("depth", "none")]:
        path = folder / depth / name
        fields[DEPTH_FIELDS[depth]] = depth_m(_read(path), scale_mm, str(path))
    return fields


def _read(path: Path) -> np.ndarray:
    try:
        return read_png(path)
    except Unreadable as error:
        raise DatasetError(f"{path.parent.parent}: {error}: export again") from error
