"""Signs of light that came by way of a mirror: mirrored positions, and brighter rivals."""

import math

import numba
import numpy as np
from jaxtyping import Float32

from ....base.frames import transform_points
from ....base.kernels import kernel
from ....rig.optics import project
from ....rig.pair import Rig
from ....rig.pattern import Axis
from ..maps import DepthMap

RIVAL_PX = 6.0  # Camera pixels that are farther apart than this do not see one spot.
CELL_PX = 2.0  # Side of the cells of the projector's picture in which rivals are sought.
MOST_TURN = 2.0  # A larger handedness says no more than this one.


def orientation(
    across: Float32[np.ndarray, "h w"],
    along: Float32[np.ndarray, "h w"],
    rig: Rig,
    axis: Axis,
) -> dict[str, Float32[np.ndarray, "h w"]]:
    """Return how positions change from pixel to pixel, in units of a facing surface.

    Where a surface that faces both devices is seen directly, positions grow by one unit per pixel
    in the direction of their axis, and hardly change aside. Light that came by way of one mirror
    makes a mirror image, in which the two axes have the other handedness.

    Args:
        across: positions along `axis` [px], which gives depth.
        along: positions along the other axis [px].
    """
    camera, projector, T = rig.camera, rig.projector, rig.T_proj_cam
    unit_x = np.float32(projector.fx_px / camera.fx_px * np.sign(T[0, 0]))
    unit_y = np.float32(projector.fy_px / camera.fy_px * np.sign(T[1, 1]))
    slopes = np.empty((2, 2, *across.shape), dtype=np.float32)
    for place, own in zip((across, along), slopes, strict=True):
        _slopes(place, own)
    forward, aside, unit = (1, 0, unit_x) if axis == "column" else (0, 1, unit_y)
    turn = slopes[0, forward] * slopes[1, aside] - slopes[0, aside] * slopes[1, forward]
    return {
        "slope forward": slopes[0, forward] / unit,
        "slope aside": np.abs(slopes[0, aside] / unit),
        "handedness": np.clip(turn / (unit_x * unit_y), -MOST_TURN, MOST_TURN),
    }


@kernel(parallel=True, error_model="numpy")
def _slopes(place, slope):
    """Write the mean changes per pixel downwards and to the right among 3 x 3 pixels."""
    h, w = place.shape
    for row in numba.prange(h):
        y = np.int64(row)
        for x in range(w):
            for way in range(2):
                dy, dx = 1 - way, way
                total, count = np.float32(0), 0
                for k in range(-1, 2):
                    v, z = y + k * dx, x + k * dy
                    if 0 <= v - dy and v + dy < h and 0 <= z - dx and z + dx < w:
                        step = place[v + dy, z + dx] - place[v - dy, z - dx]
                        if not np.isnan(step):
                            total += np.float32(0.5) * step
                            count += 1
                known = count > 0 and not np.isnan(place[y, x])
                slope[way, y, x] = total / np.float32(count) if known else np.float32(np.nan)


def rivals(
    across: Float32[np.ndarray, "h w"],
    along: Float32[np.ndarray, "h w"],
    contrast_dn: Float32[np.ndarray, "h w"],
    depth: DepthMap,
    rig: Rig,
    axis: Axis,
) -> dict[str, Float32[np.ndarray, "h w"]]:
    """Return how far away a brighter pixel has the same position [px], and the ratio of contrasts.

    A pixel of the projector lights one spot. Of two camera pixels that decode its position, the one
    with less contrast sees the spot by way of another surface. Without a code of the other axis,
    its positions are those of the measured points.
    """
    if np.isnan(along).all():
        along = _projected_along(depth, rig, axis)
    size_px = rig.projector.width_px, rig.projector.height_px
    cells = tuple(int(side / CELL_PX) + 1 for side in size_px)
    brightest = np.full(cells if axis == "column" else cells[::-1], -1, dtype=np.int64)
    rival = np.full((2, *across.shape), np.nan, dtype=np.float32)
    _seek_rivals(across, along, contrast_dn, brightest, rival)
    return {"distance of a brighter rival": rival[0], "contrast over that of a rival": rival[1]}


def _projected_along(depth: DepthMap, rig: Rig, axis: Axis) -> Float32[np.ndarray, "h w"]:
    """Return the positions of measured points along the projector's planes [px]."""
    along = np.full(depth.depth_m.shape, np.nan, dtype=np.float32)
    known = np.isfinite(depth.depth_m)
    point_proj = transform_points(rig.T_proj_cam, depth.points().astype(np.float64))
    along[known] = project(rig.projector, point_proj)[:, 1 if axis == "column" else 0]
    return along


@kernel(error_model="numpy")
def _seek_rivals(across, along, contrast_dn, brightest, rival):
    h, w = across.shape
    rows, columns = brightest.shape
    cell = np.float32(CELL_PX)
    for y in range(h):
        for x in range(w):
            u, v = across[y, x], along[y, x]
            if np.isnan(u) or np.isnan(v):
                continue
            i, j = np.int64(u / cell), np.int64(v / cell)
            if i < 0 or j < 0 or i >= rows or j >= columns:
                continue
            at = brightest[i, j]
            if at < 0 or contrast_dn[y, x] > contrast_dn[at // w, at % w]:
                brightest[i, j] = y * w + x
    for y in range(h):
        for x in range(w):
            u, v = across[y, x], along[y, x]
            if np.isnan(u) or np.isnan(v):
                continue
            i, j = np.int64(u / cell), np.int64(v / cell)
            most, distance = contrast_dn[y, x], np.float32(0)
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    if not (0 <= a < rows and 0 <= b < columns) or brightest[a, b] < 0:
                        continue
                    at = brightest[a, b]
                    dy, dx = at // w - y, at % w - x
                    far = dy * dy + dx * dx > RIVAL_PX * RIVAL_PX
                    if far and contrast_dn[at // w, at % w] > most:
                        most = contrast_dn[at // w, at % w]
                        distance = np.float32(math.sqrt(dy * dy + dx * dx))
            rival[0, y, x] = distance
            rival[1, y, x] = contrast_dn[y, x] / most
