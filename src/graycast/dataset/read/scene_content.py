"""Load all of one image of a dataset into memory, for statistics, pages and depth scores."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.array_types import Int, UInt8, UInt16
from ...base.errors import DatasetError
from ..files.records import Box3d, ScannerRecord
from .example import known_depth
from .stored import Instance, StoredScene

NO_REASON = 255  # The dataset does not say why depth is missing.


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredInstance:
    """One instance, visible or hidden; a field that real pictures lack is None.

    `box` and `amodal_box` are BOP's [x, y, last column - first, last row - first], or -1 four times
    if nothing is visible. `box3d` is rotation (9), centre and size [mm] in the camera frame.
    """

    obj_id: int
    area_px: int
    box: list[int]
    visib_fract: float | None = None
    amodal_box: list[int] | None = None
    position_mm: list[float] | None = None
    box3d: tuple[list[float], list[float], list[float]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneContent:
    """All data of one image as stored; a picture that the dataset does not contain is None.

    Depths are multiples of `depth_scale_mm`, 0 where missing. `reason` holds keys of `reason_name`:
    0 where there is a scanner depth, and `NO_REASON` where the reason of its absence is unknown.
    `label` is the visible instance of each pixel, or -1; where masks of annotators overlap, the
    later mask counts.
    """

    stored: StoredScene
    rgb: UInt8[np.ndarray, "h w 3"] | None
    gray: UInt8[np.ndarray, "h w"] | None
    depth: UInt16[np.ndarray, "h w"] | None
    scanner: UInt16[np.ndarray, "h w"] | None
    reason: UInt8[np.ndarray, "h w"]
    label: Int[np.ndarray, "h w"]
    view: dict[str, Any]
    instances: tuple[StoredInstance, ...]
    reason_name: dict[int, str]
    manifest: dict[str, Any]

    @property
    def depth_scale_mm(self) -> float:
        return float(self.view["depth_scale"])


def scene_content(stored: StoredScene) -> SceneContent:
    """Read all data of an image.

    Raises:
        DatasetError: a file is missing, damaged or contradicts another.
    """
    holds = stored.holds
    scanner = stored.picture("depth_sl") if "depth_sl" in holds else None
    if stored.real:
        known = np.zeros(stored.size_px, dtype=bool) if scanner is None else scanner > 0
        reason = np.where(known, 0, NO_REASON).astype(np.uint8)
        reason_name = {0: "decoded", NO_REASON: "missing"}
    else:
        reason = stored.picture("reason_sl")
        numbers = stored.of_image("scene_sl", ScannerRecord).reasons
        reason_name = {number: name.lower() for name, number in numbers.items()}
    instances = stored.instances()
    return SceneContent(
        stored=stored,
        rgb=stored.rgb() if "rgb" in holds else None,
        gray=stored.picture("gray_sl") if "gray_sl" in holds else None,
        depth=_distances(stored.picture("depth")) if "depth" in holds else None,
        scanner=scanner,
        reason=reason,
        label=label_map(instances, stored.size_px),
        view=stored.view().model_dump(),
        instances=_stored_instances(instances, stored),
        reason_name=reason_name,
        manifest=stored.manifest(),
    )


def _distances(steps: UInt16[np.ndarray, "h w"]) -> UInt16[np.ndarray, "h w"]:
    """Return steps of depth, 0 where missing; other datasets may use 65535 there."""
    return np.where(known_depth(steps), steps, 0)


def label_map(instances: list[Instance], size_px: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """Return the index of the visible instance of each pixel, or -1; a later mask counts.

    The run lengths are a hundred times faster to read than the masks.
    """
    height_px, width_px = size_px
    label = np.full(height_px * width_px, -1, dtype=np.int32)  # in columns, as in COCO
    for i, (_, _, entry) in enumerate(instances):
        turn = [] if entry is None else np.cumsum(entry.segmentation.counts).tolist()
        for start, end in zip(turn[0::2], turn[1::2], strict=False):
            label[start:end] = i
    return np.ascontiguousarray(label.reshape(width_px, height_px).T)


def _stored_instances(instances: list[Instance], stored: StoredScene) -> tuple[StoredInstance, ...]:
    if stored.real:
        return tuple(
            StoredInstance(obj_id=pose.obj_id, area_px=info.px_count_visib, box=info.bbox_visib)
            for pose, info, _ in instances
        )
    boxes = stored.of_instances("scene_gt_box3d", Box3d)
    if len(boxes) != len(instances):
        raise DatasetError(
            f"{stored.folder}: scene_gt_box3d.json has {len(boxes)} boxes, scene_gt.json "
            f"{len(instances)} instances: run graycast validate"
        )
    return tuple(
        StoredInstance(
            obj_id=pose.obj_id,
            area_px=info.px_count_visib,
            box=info.bbox_visib,
            visib_fract=info.visib_fract,
            amodal_box=info.bbox_obj,
            position_mm=pose.cam_t_m2c,
            box3d=(box.R, box.center, box.size),
        )
        for (pose, info, _), box in zip(instances, boxes, strict=True)
    )
