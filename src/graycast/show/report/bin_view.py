"""The crop of a contact sheet around the bin, and the range of depths for its colours."""

import itertools

import numpy as np

from ...base.frames import inverse, transform_points
from ...cell.framing import bin_corners_m
from ...rendering import GroundTruth
from ...rig.optics import project
from ...world.scene import Scene

_AROUND = 0.04  # margin of the crop around the bin, as a share of the bin's longer side
_MARGIN = 0.02  # margin of the colour scale around the depths, as a share of their range

Crop = tuple[int, int, int, int]  # left, top, width and height in pixels


def bin_crop(scene: Scene, truth: GroundTruth) -> Crop:
    """Return the rectangle of the picture that contains the bin and all visible parts.

    The rectangle is at least as wide as it is high, if the picture permits. It is the whole picture
    without a bin, or if the lens model does not reach a corner of the bin.
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
    if right - left < 2 or bottom - top < 2:  # The bin is outside the picture.
        return whole
    return left, top, right - left, bottom - top


def depth_limits_mm(scene: Scene, truth: GroundTruth) -> tuple[float, float]:
    """Return the smallest and largest depth of the bin and of visible parts, for the colours.

    Without a bin, these are the limits of the whole picture.
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
