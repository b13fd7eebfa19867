"""The surface in saturated areas, which have no depth of their own."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

JOIN_PX = 3  # An area joins saturated pixels and the pixels between them, over twice this gap.
TRIALS = 300  # sampled planes
NEAR_SHARE = 5e-4  # A pixel is on a plane if its depth is off by at most this share.
LEAST_SHARE = 0.5  # An area stays unknown if fewer of its pixels with depth are on one plane,
LEAST_INSIDE = 0.05  # or if it has fewer pixels with depth per saturated pixel.


def continue_planes(
    depth_m: Float[np.ndarray, "h w"], saturated: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return depth in which each saturated area continues the plane of the depth inside it.

    An area joins saturated pixels that are close together, with the pixels between them. A facet
    that is saturated as a whole stays unknown: the depth around it is that of other facets.

    Leaves out: curved surfaces.
    """
    wanted = saturated & np.isnan(depth_m)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * JOIN_PX + 1,) * 2)
    count, label = cv2.connectedComponents(
        cv2.morphologyEx(wanted.astype(np.uint8), cv2.MORPH_CLOSE, disc)
    )
    filled = depth_m.copy()
    for number in range(1, count):
        area = label == number
        inside, own = area & np.isfinite(depth_m), area & wanted
        if inside.sum() < max(3, LEAST_INSIDE * own.sum()):
            continue
        plane = _largest_plane(1 / depth_m[inside], np.argwhere(inside))
        if plane is not None:
            filled[own] = 1 / (np.argwhere(own) @ plane[:2] + plane[2])
    return filled


def _largest_plane(
    inverse_m: Float[np.ndarray, " n"], pixel: np.ndarray
) -> Float[np.ndarray, "3"] | None:
    """Return a, b, c of the plane `1/z = a row + b column + c` that fits most pixels, if any."""
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
