"""Detections in a picture, and COCO results files that store them."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pycocotools import mask as coco_mask

from ...base import array_types as arrays
from ...base.errors import GraycastError
from ...base.file_limits import check_runs, parse_json
from ...base.public_value import public_value

RESULTS, DETECT_JSON = "results.json", "detect.json"
WEIGHTS = "detector.pt"  # The command `graycast detector train` writes this file.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """The detections in one picture, in descending order of score.

    Attributes:
        scene_id: the scene of the picture; COCO's `image_id`.
        score: score of each detection, from 0 to 1 for the detectors of `detect`.
        obj_id: the object of each detection; COCO's `category_id`.
        box_px: [x, y, width, height] as in COCO: (0, 0) is the outer corner of the top-left
            pixel, so a box that begins in the first column has x = 0.
        mask: the compressed run-length encoding of each mask as in COCO; None if the detector
            does not predict masks.
    """

    scene_id: int
    score: arrays.FloatArray_n
    obj_id: arrays.IntArray_n
    box_px: arrays.FloatArray_n_4
    mask: tuple[Mapping[str, Any], ...] | None = None

    def __post_init__(self) -> None:
        for name in ("score", "obj_id", "box_px"):
            getattr(self, name).flags.writeable = False

    def __len__(self) -> int:
        return len(self.score)


def results_bytes(pictures: Sequence[Detections]) -> bytes:
    """Return COCO results: a list with the box and, if known, the mask of each detection.

    Numbers have just enough digits to read back the same values.
    """
    lines = [json.dumps(entry, allow_nan=False) for each in pictures for entry in _entries(each)]
    return ("[\n" + ",\n".join(lines) + "\n]\n").encode()


def _entries(one: Detections) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = [
        {
            "image_id": one.scene_id,
            "category_id": int(obj_id),
            "bbox": [_shortest(edge) for edge in box],
            "score": _shortest(score),
        }
        for obj_id, box, score in zip(one.obj_id, one.box_px, one.score, strict=True)
    ]
    if one.mask is not None:
        for entry, mask in zip(entries, one.mask, strict=True):
            size = [int(edge) for edge in mask["size"]]
            entry["segmentation"] = {"size": size, "counts": mask["counts"]}
    return entries


def _shortest(value: np.floating) -> float:
    """Return the shortest decimal that reads back as this number in its own precision."""
    return float(str(value))


def read_results(
    path: Path, scene_ids: Sequence[int], *, obj_ids: Collection[int] | None = None
) -> list[Detections]:
    """Read the detections of each scene from COCO results of any program.

    An entry with a mask may lack a box; its box is then computed from the mask.

    Args:
        obj_ids: object ids of the dataset; None accepts all ids.

    Raises:
        GraycastError: the file is missing or damaged, names an unknown scene or object, or has
            masks for only some of its detections.
    """
    try:
        entries = parse_json(path.read_bytes())
    except OSError as error:
        raise GraycastError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise GraycastError(f"{path}: is not JSON, or is cut off ({error})") from error
    if not isinstance(entries, list):
        raise GraycastError(f"{path}: is not a JSON list: give a file of COCO results")
    of_scene: dict[int, list[dict[str, Any]]] = {scene_id: [] for scene_id in scene_ids}
    for i, entry in enumerate(entries):
        where = f"{path}: entry {i}"
        _check(entry, where)
        if entry["image_id"] not in of_scene:
            raise GraycastError(
                f"{where} is of image {entry['image_id']}, which is not in this set of the "
                "dataset: give results of the same dataset and set"
            )
        if obj_ids is not None and entry["category_id"] not in obj_ids:
            raise GraycastError(
                f"{where} is of category {entry['category_id']}, and the dataset has "
                f"{', '.join(map(str, sorted(obj_ids)))}: give results of this dataset"
            )
        of_scene[entry["image_id"]].append(entry)
    masked = {"segmentation" in entry for entry in entries}
    if len(masked) > 1:
        raise GraycastError(
            f"{path}: some entries have a segmentation and others have none: give all entries "
            "one, or none"
        )
    return [_detections(scene_id, rows, masked == {True}) for scene_id, rows in of_scene.items()]


def _check(entry: Any, where: str) -> None:
    keys = ("image_id", "category_id", "score")
    if not isinstance(entry, dict) or not all(key in entry for key in keys):
        raise GraycastError(f"{where} lacks one of {', '.join(keys)}: give COCO results")
    if not ("bbox" in entry or "segmentation" in entry):
        raise GraycastError(f"{where} has neither bbox nor segmentation: give COCO results")
    for key in ("image_id", "category_id"):
        if type(entry[key]) is not int:
            raise GraycastError(f"{where}: {key} is {entry[key]!r}; it must be a whole number")
    if not _finite(entry["score"]):
        raise GraycastError(f"{where}: score is {entry['score']!r}; it must be a finite number")
    if "bbox" in entry:
        box = entry["bbox"]
        if not (isinstance(box, list) and len(box) == 4 and all(map(_finite, box))):
            raise GraycastError(f"{where}: bbox is {box!r}; it must be four finite numbers")
        if min(box[2:]) < 0:
            raise GraycastError(
                f"{where}: bbox is {box!r}; columns and rows, its last two numbers, must not be "
                "negative: give x, y, width, height and not x0, y0, x1, y1"
            )
    if "segmentation" in entry:
        check_runs(entry["segmentation"], f"{where}: segmentation", GraycastError)


def _finite(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _detections(scene_id: int, entries: list[dict[str, Any]], masked: bool) -> Detections:
    entries = sorted(entries, key=lambda entry: -entry["score"])  # Equal scores keep their order.
    masks = [_compressed(entry["segmentation"]) for entry in entries] if masked else []
    boxes = [
        entry["bbox"] if "bbox" in entry else coco_mask.toBbox(masks[i]).tolist()
        for i, entry in enumerate(entries)
    ]
    return Detections(
        scene_id=scene_id,
        score=np.array([entry["score"] for entry in entries], np.float64),
        obj_id=np.array([entry["category_id"] for entry in entries], np.int64),
        box_px=np.array(boxes, np.float64).reshape(-1, 4),
        mask=tuple(masks) if masked else None,
    )


def _compressed(runs: dict[str, Any]) -> dict[str, Any]:
    if isinstance(runs["counts"], str):
        return runs
    return {
        "size": runs["size"],
        "counts": coco_mask.frPyObjects(runs, *runs["size"])["counts"].decode(),
    }
