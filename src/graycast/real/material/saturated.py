"""The surface in saturated areas, which have no depth of their own."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

AROUND_PX = 8  # Depth within this distance of a saturated area shows the plane of the area.
TRIALS = 300  # sampled planes
NEAR_SHARE = 5e-4  # A pixel is on a plane if its depth is off by at most this share.
LEAST_SHARE = 0.3  # Areas with fewer of the surrounding pixels on one plane stay unknown.


def continue_planes(
    depth_m: Float[np.ndarray, "h w"], saturated: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return depth in which each saturated area continues the largest plane around it.

    An area joins saturated pixels that are at most `AROUND_PX` apart from a neighbour. Pixels with
    depth stay as they are.

    Leaves out: curved surfaces; a highlight at an edge gets the plane with more pixels.
    """
    unknown = np.isnan(depth_m)
    wanted = saturated & unknown
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * AROUND_PX + 1,) * 2)
    count, label = cv2.connectedComponents(
        cv2.morphologyEx(wanted.astype(np.uint8), cv2.MORPH_CLOSE, disc)
    )
    filled = depth_m.copy()
    for number in range(1, count):
        area = label == number
        around = (cv2.dilate(area.astype(np.uint8), disc) > 0) & ~unknown
        plane = _largest_plane(1 / depth_m[around], np.argwhere(around))
        if plane is not None:
            own = wanted & area
            filled[own] = 1 / (np.argwhere(own) @ plane[:2] + plane[2])
    return filled


def _largest_plane(
    inverse_m: Float[np.ndarray, " n"], pixel: np.ndarray
) -> Float[np.ndarray, "3"] | None:
    """Return a, b, c of the plane `1/z = a row + b column + c` that fits most pixels."""
    if len(pixel) < 3:
        return None
    rng = np.random.default_rng(0)
    design = np.column_stack([pixel, np.ones(len(pixel))])
    best = np.zeros(len(pixel), dtype=bool)
    for _ in range(TRIALS):
        pick = rng.choice(len(pixel), 3, replace=False)
        if abs(np.linalg.det(design[pick])) > 1:
            plane = np.linalg.solve(design[pick], inverse_m[pick])
            on_plane = np.abs(design @ plane / inverse_m - 1) < NEAR_SHARE
            best = max(best, on_plane, key=np.count_nonzero)
    if best.sum() < max(3, LEAST_SHARE * len(pixel)):
        return None
    return np.linalg.lstsq(design[best], inverse_m[best], rcond=None)[0]
