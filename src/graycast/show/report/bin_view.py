"""View of a contact sheet: the bin's part of the picture, and the bin's depths."""

import itertools

import numpy as np

from ...base.frames import inverse, transform_points
from ...cell.framing import bin_corners_m
from ...rendering import GroundTruth
from ...rig.optics import project
from ...world.scene import Scene

_AROUND = 0.04  # The bin's outline is this share of its length away from the edge of the crop.
_MARGIN = 0.02  # The colours reach further than the depths by this share of their range.

Crop = tuple[int, int, int, int]  # left, top, width and height in pixels


def bin_crop(scene: Scene, truth: GroundTruth) -> Crop:
    """Return the rectangle of the picture that has the whole bin and all visible parts.

    It is at least as wide as it is high, where the picture is. Without a bin, or if a corner of the
    bin is beyond the lens model, it is the whole picture.
    """
    camera = scene.rig.camera
    whole = (0, 0, camera.width_px, camera.height_px)
    if scene.bin is None:
        return whole
    corner = np.array([*itertools.product(*scene.bin.bounds_m.T)])
    pixel = project(camera, transform_points(inverse(scene.T_world_cam), corner))
    if not np.isfinite(pixel).all():
        return whole
    around_px = _AROUND * np.ptp(pixel, axis=0).max()
    low, high = pixel.min(axis=0) - around_px, pixel.max(axis=0) + around_px
    rows, columns = np.nonzero(truth.instance >= 0)
    if rows.size:
        low = np.minimum(low, (columns.min(), rows.min()))
        high = np.maximum(high, (columns.max(), rows.max()))
    width_px, height_px = high - low
    wider_px = np.array([max(0.0, height_px - width_px) / 2, 0.0])
    low, high = low - wider_px, high + wider_px
    left, top = np.floor(low).clip(0).astype(int).tolist()
    right, bottom = (np.ceil(high).astype(int) + 1).clip(max=whole[2:]).tolist()
    if right - left < 2 or bottom - top < 2:  # The camera looks past the bin.
        return whole
    return left, top, right - left, bottom - top


def depth_limits_mm(scene: Scene, truth: GroundTruth) -> tuple[float, float]:
    """Return the least and the greatest depth that have colours: those of bin and visible parts.

    Without a bin they are those of the whole picture.
    """
    if scene.bin is None:
        depth_m = truth.depth_m.ravel()
    else:
        in_camera = transform_points(inverse(scene.T_world_cam), bin_corners_m(scene.bin))
        depth_m = np.concatenate([in_camera[:, 2], truth.depth_m[truth.instance >= 0]])
    known = depth_m[np.isfinite(depth_m)]
    if known.size == 0:
        return 0.0, 1.0
    margin_m = max(_MARGIN * float(np.ptp(known)), 1e-4)
    return 1e3 * (float(known.min()) - margin_m), 1e3 * (float(known.max()) + margin_m)
