"""Decode pictures from bytes and masks from run lengths, for several formats."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pycocotools import mask as coco_mask

from ...base.array_types import Bool, Float32, UInt8
from ...base.errors import DatasetError
from ..files.safe_reading import Unreadable, pixels
from ..read.example import metres

DEPTH_FIELDS = {"depth": "depth_m", "depth_sl": "scanner_depth_m"}  # field of `Example` by kind


def picture(data: bytes, name: str) -> np.ndarray:
    """Decode a picture as stored, with colours in OpenCV's order.

    Raises:
        DatasetError: the data are not a picture.
    """
    try:
        return pixels(data, name)
    except Unreadable as error:
        raise DatasetError(f"{error}: export again") from error


def image_fields(kind: str, image: np.ndarray, name: str) -> dict[str, UInt8[np.ndarray, "..."]]:
    """Return a picture under the name of its field in `Example`, which is the picture's kind."""
    if (image.ndim == 3) != (kind == "rgb") or image.dtype != np.uint8:
        raise DatasetError(f"{name}: is {image.dtype} {image.shape}, not 8-bit {kind}")
    return {kind: np.ascontiguousarray(image[..., ::-1]) if kind == "rgb" else image}


def depth_m(steps: np.ndarray, scale_mm: float, name: str) -> Float32[np.ndarray, "h w"]:
    """Convert a 16-bit depth picture to metres."""
    if steps.ndim != 2 or steps.dtype != np.uint16:
        raise DatasetError(
            f"{name}: is {steps.dtype} {steps.shape}, but depth must have one channel of 16 bits"
        )
    return metres(steps, scale_mm)


def masks(
    runs: Sequence[dict[str, Any]], size_px: tuple[int, int], name: str
) -> Bool[np.ndarray, "n h w"]:
    """Return the masks of one picture from COCO's run lengths, compressed or uncompressed.

    Raises:
        DatasetError: the size of a mask differs from that of the picture.
    """
    mask = np.zeros((len(runs), *size_px), dtype=bool)
    for i, run in enumerate(runs):
        if list(run["size"]) != list(size_px):
            raise DatasetError(f"{name}: mask {i} is {run['size']}, the picture {list(size_px)}")
        mask[i] = coco_mask.decode(compressed(run, size_px))
    return mask


def compressed(segmentation: Any, size_px: tuple[int, int]) -> dict[str, Any]:
    """Return compressed run lengths of COCO's polygons or run lengths."""
    if isinstance(segmentation, list):
        return coco_mask.merge(coco_mask.frPyObjects(segmentation, *size_px))
    if isinstance(segmentation["counts"], list):
        return coco_mask.frPyObjects(segmentation, *size_px)
    return segmentation


def boxes(mask: Bool[np.ndarray, "n h w"]) -> Float32[np.ndarray, "n 4"]:
    """Return [x, y, width, height] of masks that are not empty."""
    encoded = coco_mask.encode(np.asfortranarray(np.moveaxis(mask, 0, -1), dtype=np.uint8))
    return coco_mask.toBbox(encoded).astype(np.float32).reshape(-1, 4)
