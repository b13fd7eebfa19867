"""The labels of a picture: the instances that a detector should find."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from pycocotools import mask as coco_mask

from ...base.errors import GraycastError
from ...base.public_value import public_value
from ...dataset.read.example import Example
from ...dataset.write.coco import IGNORED_BELOW

MIN_VISIBILITY = IGNORED_BELOW


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """The instances in one picture that are at least partly visible.

    Attributes:
        scene_id: number of the picture in its dataset; the scene's number if it has one picture.
        scene: number of the picture's scene.
        size_px: height and width of the picture; None if unknown.
        obj_id: object id of each instance.
        box_px: box of each visible mask as [x, y, columns, rows], as for detections.
        mask: visible mask of each instance as compressed run lengths; None without masks.
        ignored: whether the instance is too hidden to count; detecting it is no mistake.
        visib_fract: visible share of each silhouette; None if unknown.
        missing: share of each visible mask without scanner depth; None if unknown.
        instance: index of each instance in the dataset's `scene_gt.json`; None without that file.
    """

    scene_id: int
    scene: int
    size_px: tuple[int, int] | None
    obj_id: Int[np.ndarray, " n"]
    box_px: Float32[np.ndarray, "n 4"]
    mask: tuple[Mapping[str, Any], ...] | None
    ignored: Bool[np.ndarray, " n"]
    visib_fract: Float[np.ndarray, " n"] | None
    missing: Float[np.ndarray, " n"] | None = None
    instance: Int[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        for name in ("obj_id", "box_px", "ignored", "visib_fract", "missing", "instance"):
            if (value := getattr(self, name)) is not None:
                value.flags.writeable = False

    def __len__(self) -> int:
        return len(self.obj_id)


def labels_of(example: Example, *, min_visibility: float, scene: int | None = None) -> Labels:
    """Return the labels of an example; instances below `min_visibility` are marked as ignored.

    If visible shares are unknown, no instance is ignored. `scene` is the number of the picture's
    scene; it is needed if scenes have several pictures.

    Raises:
        GraycastError: the example has no labels.
    """
    if example.obj_id is None or example.box_px is None:
        raise GraycastError(
            f"scene {example.scene_id}: has no labels to compare detections with: give a dataset "
            "with labels"
        )
    return Labels(
        scene_id=example.scene_id,
        scene=example.scene_id if scene is None else scene,
        size_px=_size_px(example),
        obj_id=example.obj_id,
        box_px=example.box_px,
        mask=None if example.mask is None else run_lengths_of(example.mask),
        ignored=example.hidden(min_visibility),
        visib_fract=example.visib_fract,
        missing=_missing(example),
        instance=example.instance,
    )


def run_lengths_of(mask: Bool[np.ndarray, "n h w"]) -> tuple[dict[str, Any], ...]:
    """Return masks as compressed run lengths in COCO's format."""
    if not len(mask):
        return ()
    columns = np.asfortranarray(mask.transpose(1, 2, 0).astype(np.uint8))
    return tuple(
        {"size": [int(edge) for edge in runs["size"]], "counts": runs["counts"].decode()}
        for runs in coco_mask.encode(columns)
    )


def _size_px(example: Example) -> tuple[int, int] | None:
    for name in ("mask", "rgb", "gray", "depth_m", "scanner_depth_m"):
        picture = getattr(example, name)
        if picture is not None:
            height_px, width_px = picture.shape[1:] if name == "mask" else picture.shape[:2]
            return height_px, width_px
    return None


def _missing(example: Example) -> Float[np.ndarray, " n"] | None:
    if example.mask is None or example.scanner_depth_m is None:
        return None
    hole = np.isnan(example.scanner_depth_m)
    return np.array([hole[mask].mean() for mask in example.mask], dtype=np.float64)
