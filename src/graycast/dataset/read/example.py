"""One picture and its labels as arrays for training, from any file format."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pycocotools import mask as coco_mask

from ...base import array_types as arrays
from ...base.array_types import Bool, Float, Float32, UInt8, UInt16
from ...base.errors import DatasetError
from ...base.frames import rigid
from ...base.public_value import public_value
from ..files.records import MM_PER_M

if TYPE_CHECKING:  # Reading a dataset does not import the packages that a camera needs.
    from ...rig.optics import Optics


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """One picture and its labels, for the instances that are at least partly visible.

    A field is None if the dataset or format does not contain it.

    Attributes:
        scene_id: the picture's number in its dataset.
        K: pinhole intrinsics [px]; the centre of the top-left pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3 of OpenCV.
        rgb: the colour picture, 8-bit sRGB.
        gray: the scanner's white frame, 8 bit, linear.
        depth_m: perfect depth, z in the camera frame [m]; NaN where unknown.
        scanner_depth_m: depth that the scanner measured [m]; NaN where it measured nothing.
        p_wrong: probability that the scanner's depth is wrong; NaN where it measured nothing.
        instance: index of each instance in the dataset's `scene_gt.json`.
        obj_id: object id of each instance.
        mask: the visible mask of each instance.
        box_px: [x, y, width, height] of the visible masks; the image's corner is (0, 0).
        T_cam_part: pose of each part in the camera frame [m].
        visib_fract: visible fraction of each silhouette.
        ignored: instances that are neither required nor background, such as COCO's crowds.
    """

    scene_id: int
    K: arrays.FloatArray_3_3 | None = None
    distortion: tuple[float, ...] | None = None
    rgb: arrays.UInt8Array_h_w_3 | None = None
    gray: arrays.UInt8Array_h_w | None = None
    depth_m: arrays.Float32Array_h_w | None = None
    scanner_depth_m: arrays.Float32Array_h_w | None = None
    p_wrong: arrays.Float32Array_h_w | None = None
    instance: arrays.IntArray_n | None = None
    obj_id: arrays.IntArray_n | None = None
    mask: arrays.BoolArray_n_h_w | None = None
    box_px: arrays.Float32Array_n_4 | None = None
    T_cam_part: arrays.FloatArray_n_4_4 | None = None
    visib_fract: arrays.FloatArray_n | None = None
    ignored: arrays.BoolArray_n | None = None

    @property
    def camera(self) -> "Optics":
        """The camera that took the picture.

        Raises:
            DatasetError: the example has no depth or no intrinsics.
        """
        from ...rig.optics import optics_of

        depth = self.depth_m if self.scanner_depth_m is None else self.scanner_depth_m
        if self.K is None or depth is None:
            raise DatasetError(
                f"scene {self.scene_id} has no depth or no intrinsics: give a dataset that "
                "graycast generate made"
            )
        return optics_of(self.K, depth.shape, self.distortion or (0.0,) * 5)

    def points(self) -> arrays.FloatArray_n_3:
        """Return the points [m] in the camera frame: measured or, without a scan, true ones.

        Raises:
            DatasetError: the example has no depth or no intrinsics.
        """
        from ...rig.optics import points

        camera = self.camera
        depth_m = self.depth_m if self.scanner_depth_m is None else self.scanner_depth_m
        assert depth_m is not None, "the camera refuses an example without depth"
        return points(camera, depth_m)[np.isfinite(depth_m)]

    def hidden(self, min_visibility: float) -> arrays.BoolArray_n:
        """Return a mask of the hidden instances: ignored ones, and those below the threshold.

        If the visible fractions are unknown, only ignored instances are hidden.

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
    """Return a picture to draw on: colour, else the white frame, else depth (near is bright).

    Missing depth is black.

    Raises:
        DatasetError: the example has no picture.
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
    """One visible instance of a scene, as its files describe it.

    `segmentation` is compressed RLE, `box` is its [x, y, width, height], and `runs` are the same
    run lengths as numbers. `pose` (9 numbers of the rotation, and the translation [mm]) and
    `visib_fract` are None if they are unknown.
    """

    instance: int
    obj_id: int
    area_px: int
    box: list[int]
    segmentation: dict[str, Any]
    runs: list[int]
    pose: tuple[list[float], list[float]] | None
    visib_fract: float | None

    def window(self) -> Bool[np.ndarray, "h w"]:
        """Return the mask inside `box`, without decoding the rest of the picture."""
        (x, y, columns, rows), height_px = self.box, self.segmentation["size"][0]
        ends = np.cumsum(self.runs).clip(x * height_px, (x + columns) * height_px)
        lengths = np.diff(ends, prepend=x * height_px)  # in columns, as in COCO
        slab = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape(columns, height_px)
        return np.ascontiguousarray(slab[:, y : y + rows].T)

    @property
    def T_cam_part(self) -> Float[np.ndarray, "4 4"]:
        """Transform from the part to the camera frame [m].

        Raises:
            DatasetError: the pose is unknown.
        """
        if self.pose is None:
            raise DatasetError(f"instance {self.instance}: has no pose")
        return pose_m(*self.pose)


def pose_m(rotation: list[float], translation_mm: list[float]) -> Float[np.ndarray, "4 4"]:
    """Convert a pose of BOP's files to a matrix with its translation in metres."""
    R = np.array(rotation, dtype=np.float64).reshape(3, 3)
    return rigid(R, np.array(translation_mm, dtype=np.float64) / MM_PER_M)


def known_depth(value: np.ndarray) -> Bool[np.ndarray, "..."]:
    """Return a mask of the pixels of a depth picture that contain a distance.

    Cameras write 0, NaN, infinity or the type's largest value (65535 for 16 bits) where they
    measured nothing, so all pixels with these values count as missing.
    """
    if value.dtype.kind in "ui":
        return (value != 0) & (value != np.iinfo(value.dtype).max)
    return np.isfinite(value) & (value != 0) & (np.abs(value) != np.finfo(value.dtype).max)


LEAST_LOG_P, P_STEPS = -4, 254  # The logarithm of the lowest stored probability, and its steps.


def probabilities(steps: UInt8[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return the probabilities of a `pwrong_sl` picture; NaN for step 0."""
    exponent = LEAST_LOG_P * (255.0 - steps) / P_STEPS
    return np.where(steps > 0, 10**exponent, np.nan).astype(np.float32)


def metres(steps: UInt16[np.ndarray, "h w"], scale_mm: float) -> Float32[np.ndarray, "h w"]:
    """Return a depth picture in metres; NaN where it holds no distance (see `known_depth`)."""
    depth_m = steps.astype(np.float64) * (scale_mm / MM_PER_M)
    return np.where(known_depth(steps), depth_m, np.nan).astype(np.float32)


def label_arrays(labels: list[InstanceLabel], size_px: tuple[int, int]) -> dict[str, Any]:
    """Return the labels as the fields of an `Example`."""
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
