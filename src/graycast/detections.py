"""What a detector finds in a picture, and COCO's results files, which hold it."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from .dataset.json_text import json_bytes
from .errors import GraycastError


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """What was found in one picture, best first.

    Attributes:
        scene_id: of the dataset that the picture is of; COCO's `image_id`.
        score: 0 to 1, falling.
        obj_id: what each is; COCO's `category_id`.
        box_px: [x, y, columns, rows] as COCO has them: (0, 0) is the outer corner of the top-left
            pixel, so a box from the first column on has x = 0.
        mask: run lengths of each, compressed as COCO's; None from a detector without masks.
    """

    scene_id: int
    score: Float32[np.ndarray, " n"]
    obj_id: Int[np.ndarray, " n"]
    box_px: Float32[np.ndarray, "n 4"]
    mask: tuple[Mapping[str, Any], ...] | None = None

    def __post_init__(self) -> None:
        for name in ("score", "obj_id", "box_px"):
            getattr(self, name).flags.writeable = False

    def __len__(self) -> int:
        return len(self.score)


def results_bytes(found: Sequence[Detections]) -> bytes:
    """COCO's results: a list with an entry for each detection, its box and, if any, its mask."""
    return json_bytes([entry for each in found for entry in _entries(each)])


def _entries(found: Detections) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = [
        {
            "image_id": found.scene_id,
            "category_id": int(obj_id),
            "bbox": [round(float(edge), 3) for edge in box],
            "score": round(float(score), 6),
        }
        for obj_id, box, score in zip(found.obj_id, found.box_px, found.score, strict=True)
    ]
    if found.mask is not None:
        for entry, mask in zip(entries, found.mask, strict=True):
            entry["segmentation"] = {"size": list(mask["size"]), "counts": mask["counts"]}
    return entries


def read_results(path: Path, scene_ids: Sequence[int]) -> list[Detections]:
    """Detections of each scene from COCO's results, whoever wrote them; none where it has none.

    Raises:
        GraycastError: the file is missing or damaged, or has a scene that is not among
            `scene_ids`, or masks for some of its detections alone.
    """
    try:
        entries = json.loads(path.read_bytes())
    except OSError as error:
        raise GraycastError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise GraycastError(f"{path}: is not JSON, or is cut off ({error})") from error
    if not isinstance(entries, list):
        raise GraycastError(f"{path}: is no list: give a file of COCO results")
    of_scene: dict[int, list[dict[str, Any]]] = {scene_id: [] for scene_id in scene_ids}
    for i, entry in enumerate(entries):
        _check(entry, f"{path}: entry {i}")
        if entry["image_id"] not in of_scene:
            raise GraycastError(
                f"{path}: entry {i} is of image {entry['image_id']}, which the dataset's set does "
                "not have: are these results of another dataset or another split?"
            )
        of_scene[entry["image_id"]].append(entry)
    masked = {"segmentation" in entry for entry in entries}
    if len(masked) > 1:
        raise GraycastError(f"{path}: some entries have a segmentation and others have none")
    return [_detections(scene_id, held, masked == {True}) for scene_id, held in of_scene.items()]


def _check(entry: Any, where: str) -> None:
    keys = ("image_id", "category_id", "score", "bbox")
    if not isinstance(entry, dict) or not all(key in entry for key in keys):
        raise GraycastError(f"{where} lacks one of {', '.join(keys)}: give COCO results")
    box = entry["bbox"]
    numbers = [*(box if isinstance(box, list) else []), entry["score"]]
    if len(numbers) != 5 or not all(
        isinstance(number, int | float) and math.isfinite(number) for number in numbers
    ):
        raise GraycastError(f"{where}: bbox is four finite numbers and score is one")
    runs = entry.get("segmentation")
    if runs is not None and not (isinstance(runs, dict) and isinstance(runs.get("counts"), str)):
        raise GraycastError(f"{where}: segmentation is no compressed run lengths (size, counts)")


def _detections(scene_id: int, entries: list[dict[str, Any]], masked: bool) -> Detections:
    entries = sorted(entries, key=lambda entry: -entry["score"])  # stable: equal scores as stored
    return Detections(
        scene_id=scene_id,
        score=np.array([entry["score"] for entry in entries], np.float32),
        obj_id=np.array([entry["category_id"] for entry in entries], np.int64),
        box_px=np.array([entry["bbox"] for entry in entries], np.float32).reshape(-1, 4),
        mask=tuple(entry["segmentation"] for entry in entries) if masked else None,
    )
