"""The position of a pixel against the positions around it."""

import math

import cv2
import numba
import numpy as np
from jaxtyping import Float32

from ....base.kernels import kernel
from ..union_find import flatten, sizes, unite

LINE_SIGMAS, LINE_PX = 4.0, 0.25  # A pixel this near to the line of two neighbours is in line.
SURFACE_PX = 2.5  # Neighbours whose positions differ by at most this belong to one surface.
WIDE_PX = 41  # Side of the square that counts as a pixel's surroundings.
LEAST_SPREAD_PX = 0.1


def look_around(
    place: Float32[np.ndarray, "h w"],
    sigma_px: Float32[np.ndarray, "h w"],
    contrast_dn: Float32[np.ndarray, "h w"],
) -> dict[str, Float32[np.ndarray, "h w"]]:
    """Return how well each position fits the positions and the contrasts of 5 x 5 pixels.

    Lengths are in projector pixels.

    Args:
        place: positions along one axis [px]; NaN without one.
        contrast_dn: brightest minus darkest frame.
    """
    names = (
        "off the surface",
        "off the surface over sigma",
        "pairs of neighbours",
        "pairs in line",
        "directions in line",
        "directions not in line",
        "neighbours",
        "largest step",
        "brightness over neighbours",
        "range of brightness",
    )
    around = np.empty((len(names), *place.shape), dtype=np.float32)
    _look_around(place, sigma_px, contrast_dn, around)
    return dict(zip(names, around, strict=True))


def surface_sizes(place: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return the number of pixels of each pixel's surface; NaN without a position."""
    parent = np.arange(place.size, dtype=np.int32)
    _connect(place, np.float32(SURFACE_PX), parent)
    size = sizes(parent).reshape(place.shape).astype(np.float32)
    return np.where(np.isnan(place), np.float32(np.nan), size)


def surroundings(place: Float32[np.ndarray, "h w"]) -> dict[str, Float32[np.ndarray, "h w"]]:
    """Return the spread of positions in a wide square [px], and the distance from their mean.

    The distance is in units of the spread.
    """
    known = np.isfinite(place)
    size = (WIDE_PX, WIDE_PX)
    value = np.where(known, place, np.float32(0))
    share = np.maximum(cv2.boxFilter(known.astype(np.float32), -1, size), np.float32(1e-6))
    mean = cv2.boxFilter(value, -1, size) / share
    square = cv2.sqrBoxFilter(value, -1, size).astype(np.float32) / share
    spread = np.sqrt(np.maximum(square - mean * mean, np.float32(LEAST_SPREAD_PX**2)))
    return {
        "off the surroundings": np.abs(place - mean) / spread,
        "spread of the surroundings": spread,
    }


@kernel(parallel=True, error_model="numpy")
def _look_around(place, sigma, contrast_dn, around):
    """Compare each position with lines through the 5 x 5 pixels around it.

    A line of two opposite neighbours must pass through the pixel (pairs), and so must the line of
    two neighbours in one direction, which also holds at the edge of a surface (directions).
    """
    h, w = place.shape
    far, nothing = np.float32(1e3), np.float32(np.nan)
    for row in numba.prange(h):
        y = np.int64(row)  # Parallel loops have unsigned counters, and `y - dy` must be signed.
        for x in range(w):
            u = place[y, x]
            if np.isnan(u):
                for j in range(len(around)):
                    around[j, y, x] = nothing
                continue
            limit = max(np.float32(LINE_SIGMAS) * sigma[y, x], np.float32(LINE_PX))
            pairs, in_line, ways, ways_in_line, near = 0, 0, 0, 0, 0
            best, step = far, np.float32(-1)
            total, least, most = np.float32(0), contrast_dn[y, x], contrast_dn[y, x]
            for dy in range(-2, 3):
                for dx in range(-2, 3):
                    v, z = y + dy, x + dx
                    if (dy == 0 and dx == 0) or v < 0 or z < 0 or v >= h or z >= w:
                        continue
                    least, most = min(least, contrast_dn[v, z]), max(most, contrast_dn[v, z])
                    other = place[v, z]
                    if np.isnan(other):
                        continue
                    near += 1
                    total += contrast_dn[v, z]
                    if abs(dy) + abs(dx) == 1:
                        step = max(step, abs(other - u))
                    opposite_v, opposite_z = y - dy, x - dx
                    inside = 0 <= opposite_v < h and 0 <= opposite_z < w
                    if inside and (dy > 0 or (dy == 0 and dx > 0)):
                        off = abs(u - np.float32(0.5) * (other + place[opposite_v, opposite_z]))
                        if not np.isnan(off):
                            pairs += 1
                            in_line += off <= limit
                            best = min(best, off)
                    beyond_v, beyond_z = v + dy, z + dx
                    inside = 0 <= beyond_v < h and 0 <= beyond_z < w
                    if inside and abs(dy) <= 1 and abs(dx) <= 1:
                        off = abs(u - np.float32(2) * other + place[beyond_v, beyond_z])
                        if not np.isnan(off):
                            ways += 1
                            ways_in_line += off <= np.float32(2) * limit
                            best = min(best, off)
            around[0, y, x] = best
            around[1, y, x] = best / sigma[y, x]
            around[2, y, x], around[3, y, x] = pairs, in_line
            around[4, y, x], around[5, y, x] = ways_in_line, ways - ways_in_line
            around[6, y, x] = near
            around[7, y, x] = step if step >= 0 else nothing
            own = max(contrast_dn[y, x], np.float32(1e-3))
            mean = max(total / np.float32(max(near, 1)), np.float32(1e-3))
            around[8, y, x] = math.log2(own / mean) if near > 0 else nothing
            around[9, y, x] = math.log2(most / max(least, np.float32(1e-3)))


@kernel()
def _connect(place, limit, parent):
    """Label each pixel with the lowest index in its surface."""
    h, w = place.shape
    for y in range(h):
        for x in range(w):
            i = y * w + x
            if x > 0 and abs(place[y, x] - place[y, x - 1]) <= limit:
                unite(parent, i, i - 1)
            if y > 0 and abs(place[y, x] - place[y - 1, x]) <= limit:
                unite(parent, i, i - w)
    flatten(parent)
