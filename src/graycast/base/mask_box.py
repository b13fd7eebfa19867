"""Bounding boxes of masks, and the overlap of a window with an image, in pixels."""

import numpy as np

from .array_types import Bool

Box = tuple[int, int, int, int]  # x, y, columns, rows
Window = tuple[slice, ...]  # rows and columns


def mask_box(mask: Bool[np.ndarray, "h w"]) -> Box:
    """Return the bounding box (x, y, columns, rows) of a mask, as in COCO; all 0 if it is empty.

    x and y are the first column and row; columns and rows are the width and height in pixels.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return 0, 0, 0, 0
    columns = np.flatnonzero(mask[rows[0] : rows[-1] + 1].any(axis=0))
    wide, high = int(columns[-1] - columns[0]) + 1, int(rows[-1] - rows[0]) + 1
    return int(columns[0]), int(rows[0]), wide, high


def overlap(
    top_px: int, left_px: int, shape: tuple[int, ...], size: tuple[int, ...]
) -> tuple[Window, Window]:
    """Return the overlap of a window with an image, in the image's and in the window's pixels.

    The window's first pixel is at (left_px, top_px) in the image, and may be outside the image.
    """
    image, own = [], []
    for start, length, end in zip((top_px, left_px), shape, size, strict=True):
        first = max(start, 0)
        last = max(min(start + length, end), first)
        image.append(slice(first, last))
        own.append(slice(first - start, last - start))
    return tuple(image), tuple(own)
