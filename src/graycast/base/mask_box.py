"""The box about a mask's pixels: one law for labels, silhouettes, crops and pictures."""

import numpy as np

from .array_types import Bool


def mask_box(mask: Bool[np.ndarray, "h w"]) -> tuple[int, int, int, int]:
    """(x, y, columns, rows) as COCO has them; all 0 for a mask without a pixel.

    The first column and row, and how many there are from the first to the last.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return 0, 0, 0, 0
    wide, high = int(columns[-1] - columns[0]) + 1, int(rows[-1] - rows[0]) + 1
    return int(columns[0]), int(rows[0]), wide, high
