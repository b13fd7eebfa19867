"""The region of a picture from which a scanner meters its exposure."""

from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool

from ..base.frames import inverse, transform_points
from ..rig.optics import project
from ..world.scene import Scene


def bin_region(scene: Scene) -> Bool[np.ndarray, "h w"] | None:
    """Return the pixels that look into the bin; None if there is no bin or no such pixel.

    It is the hull of the inner room's corners, as a user draws a region of interest around the bin.
    It knows nothing of the parts.
    """
    if scene.bin is None:
        return None
    camera = scene.rig.camera
    length_m, width_m, height_m = scene.bin.inner_m
    corners_m = np.array(
        list(product((-length_m / 2, length_m / 2), (-width_m / 2, width_m / 2), (0, height_m)))
    )
    pixels = project(camera, transform_points(inverse(scene.T_world_cam), corners_m))
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if len(pixels) < 3:
        return None
    hull = cv2.convexHull(np.clip(pixels, -1e4, 1e4).astype(np.float32))
    region = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    cv2.fillConvexPoly(region, np.round(hull).astype(np.int32), 1)
    inside = region.astype(bool)
    return inside if inside.any() else None
