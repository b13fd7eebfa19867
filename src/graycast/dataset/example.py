"""One picture and its labels as the arrays that a trainer wants, whatever file they come from."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pycocotools import mask as coco_mask

from ..base.array_types import Bool, Float, Float32, Int, UInt8, UInt16
from ..base.errors import DatasetError
from ..base.frames import rigid
from ..base.public_value import public_value
from .records import MM_PER_M

if TYPE_CHECKING:  # A dataset is read where little is installed; a camera needs more.
    from ..rig.optics import Optics


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """One picture and its labels, for the instances of which something is visible.

    What a dataset or a format does not hold is None.

    Attributes:
        scene_id: of the dataset that it comes from.
        K: pinhole intrinsics [px]; the centre of the top-left pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3 of OpenCV.
        rgb: the colour picture, 8-bit sRGB.
        gray: the scanner's white frame, 8 bit, linear.
        depth_m: perfect z of the camera frame [m], NaN where there is none.
        scanner_depth_m: z as the scanner measured it [m], NaN where it has none.
        instance: places of the instances in the dataset's `scene_gt.json`.
        obj_id: what each instance is.
        mask: what is visible of each instance.
        box_px: [x, y, columns, rows] of the visible masks; integers from the top-left pixel on.
        T_cam_part: poses, part to camera [m].
        visib_fract: visible share of each silhouette.
        ignored: instances that need not be found and are no background, as COCO's crowds.
    """

    scene_id: int
    K: Float[np.ndarray, "3 3"] | None = None
    distortion: tuple[float, ...] | None = None
    rgb: UInt8[np.ndarray, "h w 3"] | None = None
    gray: UInt8[np.ndarray, "h w"] | None = None
    depth_m: Float32[np.ndarray, "h w"] | None = None
    scanner_depth_m: Float32[np.ndarray, "h w"] | None = None
    instance: Int[np.ndarray, " n"] | None = None
    obj_id: Int[np.ndarray, " n"] | None = None
    mask: Bool[np.ndarray, "n h w"] | None = None
    box_px: Float32[np.ndarray, "n 4"] | None = None
    T_cam_part: Float[np.ndarray, "n 4 4"] | None = None
    visib_fract: Float[np.ndarray, " n"] | None = None
    ignored: Bool[np.ndarray, " n"] | None = None

    @property
    def camera(self) -> "Optics":
        """The camera that took the picture.

        Raises:
            DatasetError: the example has no depth or no intrinsics.
        """
        from ..rig.optics import optics_of

        depth = self.depth_m if self.scanner_depth_m is None else self.scanner_depth_m
        if self.K is None or depth is None:
            raise DatasetError(
                f"scene {self.scene_id} has no depth or no intrinsics: give a dataset that "
                "graycast generate made"
            )
        return optics_of(self.K, depth.shape, self.distortion or (0.0,) * 5)

    def points(self) -> Float[np.ndarray, "n 3"]:
        """The cloud that the scanner measured [m], in the camera frame; else that of true depth.

        Raises:
            DatasetError: as of `camera`.
        """
        from ..rig.optics import points

        camera = self.camera
        depth_m = self.depth_m if self.scanner_depth_m is None else self.scanner_depth_m
        assert depth_m is not None, "the camera refuses an example without depth"
        return points(camera, depth_m)[np.isfinite(depth_m)]

    def hidden(self, min_visibility: float) -> Bool[np.ndarray, " n"]:
        """The instances that do not count: ignored, or visible for less than that share.

        Where nobody knows what share is visible, that hides none.

        Raises:
            DatasetError: the example has no labels.
        """
        hidden: Bool[np.ndarray, " n"]
        if self.ignored is not None:
            hidden = self.ignored.copy()
        elif self.obj_id is not None:
            hidden = np.zeros(len(self.obj_id), bool)
        else:
            raise DatasetError(f"scene {self.scene_id}: has no labels")
        return hidden if self.visib_fract is None else hidden | (self.visib_fract < min_visibility)

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if isinstance(value := getattr(self, name), np.ndarray):
                value.flags.writeable = False


def display_image(example: Example) -> UInt8[np.ndarray, "h w 3"]:
    """What is drawn upon: colour, else the white frame, else depth from near (light) to far.

    Missing depth is black.

    Raises:
        DatasetError: the example has no picture at all.
    """
    if example.rgb is not None:
        return example.rgb
    if example.gray is not None:
        return np.repeat(example.gray[..., None], 3, axis=2)
    depth_m = example.scanner_depth_m if example.depth_m is None else example.depth_m
    if depth_m is None:
        raise DatasetError(f"scene {example.scene_id}: has no picture to show")
    known = np.isfinite(depth_m)
    near_m, far_m = np.quantile(depth_m[known], [0.01, 0.99]) if known.any() else (0.0, 1.0)
    light = np.clip((far_m - depth_m) / max(far_m - near_m, 1e-6), 0, 1)
    grey = np.where(known, 55 + 200 * np.nan_to_num(light), 0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class InstanceLabel:
    """One visible instance of a scene as its files have it.

    `segmentation` is compressed RLE, `box` [x, y, columns, rows] of it; `pose` (rotation, 9
    numbers, and translation [mm]) and `visib_fract` are None where nobody knows them.
    """

    instance: int
    obj_id: int
    area_px: int
    box: list[int]
    segmentation: dict[str, Any]
    pose: tuple[list[float], list[float]] | None
    visib_fract: float | None

    @property
    def T_cam_part(self) -> Float[np.ndarray, "4 4"]:
        """Part to camera [m].

        Raises:
            DatasetError: nobody knows it.
        """
        if self.pose is None:
            raise DatasetError(f"instance {self.instance}: has no pose")
        return pose_m(*self.pose)


def pose_m(rotation: list[float], translation_mm: list[float]) -> Float[np.ndarray, "4 4"]:
    """A pose of BOP's files in metres."""
    R = np.array(rotation, dtype=np.float64).reshape(3, 3)
    return rigid(R, np.array(translation_mm, dtype=np.float64) / MM_PER_M)


def known_depth(value: np.ndarray) -> Bool[np.ndarray, "..."]:
    """Return whether each number of a depth picture is a distance.

    0, what is not finite, and the largest number of the type (65535 of 16 bits) are none: cameras
    write them where they measured nothing, however few such pixels there are.
    """
    if value.dtype.kind in "ui":
        return (value != 0) & (value != np.iinfo(value.dtype).max)
    return np.isfinite(value) & (value != 0) & (np.abs(value) != np.finfo(value.dtype).max)


def metres(steps: UInt16[np.ndarray, "h w"], scale_mm: float) -> Float32[np.ndarray, "h w"]:
    """Return a depth picture in metres; NaN where it holds no distance (see `known_depth`)."""
    depth_m = steps.astype(np.float64) * (scale_mm / MM_PER_M)
    return np.where(known_depth(steps), depth_m, np.nan).astype(np.float32)


def label_arrays(labels: list[InstanceLabel], size_px: tuple[int, int]) -> dict[str, Any]:
    """The labels as `Example` has them."""
    count = len(labels)
    mask = np.zeros((count, *size_px), dtype=bool)
    for i, label in enumerate(labels):
        mask[i] = coco_mask.decode(label.segmentation)
    posed = all(label.pose is not None for label in labels)
    rated = all(label.visib_fract is not None for label in labels)
    pose = [label.T_cam_part for label in labels] if posed else []
    return {
        "instance": np.array([label.instance for label in labels], dtype=np.int64),
        "obj_id": np.array([label.obj_id for label in labels], dtype=np.int64),
        "mask": mask,
        "box_px": np.array([label.box for label in labels], np.float32).reshape(count, 4),
        "T_cam_part": np.array(pose, np.float64).reshape(count, 4, 4) if posed else None,
        "visib_fract": np.array([b.visib_fract for b in labels], float) if rated else None,
    }
