"""The region of a picture from which a scanner meters its automatic exposures."""

import cv2
import numpy as np
from jaxtyping import Bool

from ..base.frames import inverse, transform_points
from ..camera.exposure import ExposureSpec
from ..rig.optics import project
from ..world.scene import Scene
from .framing import bin_corners_m


def metered_region(scene: Scene, exposure: ExposureSpec) -> Bool[np.ndarray, "h w"] | None:
    """Return a mask of the pixels that see into the bin; None without a bin or such a pixel.

    The region is the hull of the bin's inner corners, like a user's region of interest; the parts
    do not change it. Fixed exposures need no region, so the result is None for them, too.
    """
    if scene.bin is None or not exposure.auto:
        return None
    camera = scene.rig.camera
    corner_m = transform_points(inverse(scene.T_world_cam), bin_corners_m(scene.bin))
    pixels = project(camera, corner_m)
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if len(pixels) < 3:
        return None
    hull = cv2.convexHull(np.clip(pixels, -1e4, 1e4).astype(np.float32))
    region = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    cv2.fillConvexPoly(region, np.round(hull).astype(np.int32), 1)
    inside = region.astype(bool)
    return inside if inside.any() else None
