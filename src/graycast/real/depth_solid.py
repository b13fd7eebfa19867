"""Conversion of a depth map to a solid with the measured surface on top.

The sides run down along the camera's rays, so that the camera does not see them, and they block
light below the surface. The solid has no bottom, because it is never seen from below.
"""

import math

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ..base.kernels import kernel
from ..rig.optics import Optics, rays
from ..world.parts import Mesh

STEP_M = 5e-3  # Neighbouring pixels with a larger step in depth are not joined.
_UNDER_M = 2e-3  # The solid's sides extend this far below the ground.
_FLAT_M = 5e-5  # A square of pixels that deviates less from a plane becomes two triangles.
_LARGEST_PX = 16  # In larger squares, straight sides would differ too much from distorted ones.
_WIDTHS = 1.7  # radius of a window in standard deviations of its Gaussian weight
_RIDGE = 1e-3  # Ridge weight in pixels: it reduces slopes that few pixels determine.
_TERMS = 6
# Shading normals are fitted to 13 x 13 pixels. With pixels of 0.5 mm, depth noise of 0.1 mm tilts
# them by 0.5 degrees RMS. It tilts the facets by 3 to 4 degrees, which would widen a highlight.
_SHADING_PX = 6

Planes = Float[np.ndarray, "h w 3"]  # inverse depth [1/m] and its change per pixel in x and y
# Each round of fits has a window radius [px], a number of terms (3: plane, 6: paraboloid) and the
# distance [m] from the surface at which the weight of a pixel falls to 1/e.
Rounds = tuple[tuple[int, int, float], ...]


def surfaces(
    depth_m: Float[np.ndarray, "h w"], solid: Bool[np.ndarray, "h w"], rounds: Rounds
) -> Planes:
    """Return a denoised surface at each pixel of the solid; NaN elsewhere.

    The inverse depth of a plane is linear over the picture, so each pixel gets the plane or the
    paraboloid of inverse depth that best fits the pixels around it. The farther a pixel is from the
    surface of the previous round, the lower is its weight, so that edges stay sharp.
    """
    value = np.where(solid, 1 / np.where(solid, depth_m, 1.0), np.nan)
    start = np.zeros((*solid.shape, 3))
    start[..., 0] = value
    return _refined(value, start, rounds)


def smooth_slopes(depth_m: Float[np.ndarray, "h w"], planes: Planes, near_m: float) -> Planes:
    """Smooth surfaces by two more rounds of fits, over 7 x 7 and 13 x 13 pixels, for shading.

    The fits are planes, because noise at the rim of a surface tilts planes less than paraboloids.
    Steps higher than three times `near_m` stay sharp; much lower steps are smoothed.

    Args:
        planes: the result of `surfaces` for this depth.
        near_m: distance from the surface at which the weight of a pixel falls to 1/e.
    """
    value = np.where(np.isfinite(planes[..., 0]), 1 / depth_m, np.nan)
    return _refined(value, planes, ((3, 3, near_m), (_SHADING_PX, 3, near_m)))


def _refined(value: Float[np.ndarray, "h w"], planes: Planes, rounds: Rounds) -> Planes:
    """Fit planes or paraboloids to inverse depth `value` in rounds; return the planes."""
    fitted = np.zeros((*value.shape, _TERMS))
    fitted[..., :3] = planes
    for radius, terms, near_m in rounds:
        fitted = _fitted(value, fitted, radius, terms, near_m)
    return fitted[..., :3].copy()


@kernel(parallel=True)
def _fitted(value, before, radius, terms, near_m):
    """Run one round of `surfaces`: fit by weighted least squares around each pixel."""
    height, width = value.shape
    fitted = before.copy()
    for i in numba.prange(height):
        A, b, basis = np.empty((terms, terms)), np.empty(terms), np.ones(_TERMS)
        for j in range(width):
            if math.isnan(value[i, j]):
                fitted[i, j, :] = np.nan
                continue
            z2_m2 = 1 / value[i, j] ** 2
            A[:, :] = 0.0
            for k in range(1, terms):
                A[k, k] = _RIDGE
            b[:] = 0.0
            for y in range(max(i - radius, 0), min(i + radius + 1, height)):
                for x in range(max(j - radius, 0), min(j + radius + 1, width)):
                    if math.isnan(value[y, x]):
                        continue
                    dx, dy = float(x - j), float(y - i)
                    basis[1], basis[2] = dx, dy
                    basis[3], basis[4], basis[5] = dx * dx, dx * dy, dy * dy
                    off = value[y, x]
                    for k in range(_TERMS):
                        off -= before[i, j, k] * basis[k]
                    far = (off * z2_m2 / near_m) ** 2
                    weight = math.exp(
                        -min(far, 50.0) - (dx * dx + dy * dy) / 2 * (_WIDTHS / radius) ** 2
                    )
                    for k in range(terms):
                        b[k] += weight * value[y, x] * basis[k]
                        for m in range(k + 1):
                            A[k, m] += weight * basis[k] * basis[m]
            if A[0, 0] > 1e-9:  # Without pixels near the last fit, that fit is kept.
                _solve(A, b)
                fitted[i, j, :terms] = b
    return fitted


@kernel(inline="always")
def _solve(A, b):
    """Solve `A x = b` in place by Cholesky factorisation; b becomes x, A's upper half is unused."""
    n = len(b)
    for k in range(n):
        for m in range(k + 1):
            left = A[k, m]
            for p in range(m):
                left -= A[k, p] * A[m, p]
            A[k, m] = math.sqrt(left) if k == m else left / A[m, m]
        for p in range(k):
            b[k] -= A[k, p] * b[p]
        b[k] /= A[k, k]
    for k in range(n - 1, -1, -1):
        for p in range(k + 1, n):
            b[k] -= A[p, k] * b[p]
        b[k] /= A[k, k]


def solid_of(
    planes: Planes,
    ground_m: Float[np.ndarray, "h w"],
    camera: Optics,
    *,
    step_m: float = STEP_M,
    covered: Float[np.ndarray, "h w 4"] | None = None,
    shading: Planes | None = None,
) -> Mesh:
    """Return the solid under the surfaces, in the camera frame; uv coordinates span the picture.

    Each pixel becomes a rectangle with the pixel's corners. Neighbours share a corner if their
    surfaces meet there. Where the surface is flat, pixels are joined to larger squares.

    Args:
        ground_m: z-depth [m] to which the sides extend; NaN where it is unknown.
        step_m: neighbours whose depths at a corner differ by more do not share the corner.
        covered: for each pixel, the shares of its left, right, upper and lower neighbours that its
            surface covers as well; None if edges are between pixels.
        shading: smoother surfaces, whose slopes give the shading normals of the top. A corner has
            the mean slope of the pixels that share it, and these belong to one surface.
            None gives a solid without normals, which is shaded flat.
    """
    height, width = planes.shape[:2]
    vertex, inverse_m = _corners(planes, step_m)
    pixel = _places(vertex, len(inverse_m))
    if covered is not None:
        slope = _slopes(vertex, planes)
        moved = _outwards(vertex, covered, len(pixel))
        deeper = inverse_m + (slope * moved).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            joined = (deeper > 0) & (np.abs(1 / deeper - 1 / inverse_m) < step_m)
        pixel = pixel + np.where(joined[:, None], moved, 0.0)
        inverse_m = np.where(joined, deeper, inverse_m)
    z_m = 1 / inverse_m
    ray = rays(camera, pixel)
    corners = _pixel_corners(vertex, np.isfinite(planes[..., 0]))
    rim, beside_rim = _rim(corners)
    first, second = rim.T
    low_m = np.maximum(_at(ground_m, pixel), z_m) + _UNDER_M
    left_up, left_down, right_down, right_up = _blocks(corners, planes, beside_rim).T
    faces = np.concatenate(
        [
            np.stack([left_up, left_down, right_up], axis=1),
            np.stack([right_up, left_down, right_down], axis=1),
            np.stack([second, first, first + len(z_m)], axis=1),
            np.stack([second, first + len(z_m), second + len(z_m)], axis=1),
        ]
    )
    share = (pixel + 0.5) / [width, height]
    uv = np.column_stack([share[:, 0], 1 - share[:, 1]])
    vertices_m = np.concatenate([ray * z_m[:, None], ray * low_m[:, None]])
    normals = None
    if shading is not None:
        top = _normals(camera, pixel, inverse_m, _slopes(vertex, shading))
        sides = Mesh(vertices_m=vertices_m, faces=faces[-2 * len(rim) :]).face_normal
        tops = faces[: len(faces) - 2 * len(rim)]
        normals = np.concatenate([top[tops], np.repeat(sides[:, None], 3, axis=1)])
    used = np.zeros(len(vertices_m), dtype=bool)
    used[faces] = True
    return Mesh(
        vertices_m=vertices_m[used],
        faces=(np.cumsum(used) - 1)[faces],
        corner_uv=np.concatenate([uv, uv])[faces],
        corner_normals=normals,
    )


# --- the mesh ------------------------------------------------------------------------------------

# Offsets from a corner's row and column to its four pixels. Corner (i, j) is above and left of
# pixel (i, j). It is slightly off the exact corner of the pixel: otherwise, the ray through a
# pixel's centre would hit the edge between the pixel's two triangles and might miss both.
_ABOUT = ((-1, -1), (-1, 0), (0, -1), (0, 0))
_CORNER_PX = np.array([-0.45, -0.48])  # x and y from the centre of pixel (i, j)


def _corners(
    planes: Planes, step_m: float
) -> tuple[Int[np.ndarray, "h1 w1 4"], Float[np.ndarray, " v"]]:
    """Return the vertex of each of a corner's four pixels (-1: none), and inverse depths."""
    height, width = planes.shape[:2]
    value = np.full((height + 1, width + 1, 4), np.nan)
    for k, (down, right) in enumerate(_ABOUT):
        own = planes @ np.array([1.0, *(_CORNER_PX - [right, down])])
        value[-down : height - down, -right : width - right, k] = own
    order = np.argsort(-value, axis=-1)  # nearest first, NaN last
    ordered = np.take_along_axis(value, order, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.diff(1 / ordered, axis=-1) > step_m  # False for NaN
    group = np.concatenate([np.zeros_like(apart[..., :1]), apart], axis=-1).cumsum(axis=-1)
    some = np.isfinite(ordered)
    name = (4 * np.arange(group[..., 0].size).reshape(group.shape[:2])[..., None] + group)[some]
    number = (np.cumsum(np.bincount(name) > 0) - 1)[name]
    total = np.bincount(number, weights=ordered[some]) / np.bincount(number)
    vertex = np.full(value.shape, -1)
    vertex[some] = number
    back = np.argsort(order, axis=-1)
    return np.take_along_axis(vertex, back, axis=-1), total


def _places(vertex: Int[np.ndarray, "h1 w1 4"], count: int) -> Float[np.ndarray, "v 2"]:
    """Return the position of each vertex in the picture [px]."""
    place = np.empty((count, 2))
    for k in range(len(_ABOUT)):
        i, j = np.nonzero(vertex[..., k] >= 0)
        place[vertex[i, j, k]] = np.column_stack([j, i]) + _CORNER_PX
    return place


def _slopes(vertex: Int[np.ndarray, "h1 w1 4"], planes: Planes) -> Float[np.ndarray, "v 2"]:
    """Return the slope of the inverse depth at each vertex, per pixel in x and y."""
    i, j, k = np.nonzero(vertex >= 0)
    number = vertex[i, j, k]
    count = np.bincount(number)
    down, right = np.array(_ABOUT)[k].T
    slope = planes[i + down, j + right, 1:]
    return np.column_stack([np.bincount(number, weights=own) / count for own in slope.T])


def _normals(
    camera: Optics,
    pixel: Float[np.ndarray, "v 2"],
    inverse_m: Float[np.ndarray, " v"],
    slope: Float[np.ndarray, "v 2"],
) -> Float[np.ndarray, "v 3"]:
    """Return unit normals, towards the camera, of surfaces with these slopes of inverse depth.

    A point is `ray / inverse depth`. The normal is perpendicular to the point's derivatives along
    x and y; the code multiplies both by the squared inverse depth, which avoids a division.
    """
    ray = rays(camera, pixel)
    tangents = [
        inverse_m[:, None] * (rays(camera, pixel + half) - rays(camera, pixel - half))
        - own[:, None] * ray
        for half, own in zip(0.5 * np.eye(2), slope.T, strict=True)
    ]
    across = np.cross(tangents[1], tangents[0])
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def _outwards(
    vertex: Int[np.ndarray, "h1 w1 4"], covered: Float[np.ndarray, "h w 4"], count: int
) -> Float[np.ndarray, "v 2"]:
    """Return the shift [px] of each vertex so that surfaces cover the shares in `covered`."""
    most, least = np.zeros((count, 2)), np.zeros((count, 2))
    for k, (down, right) in enumerate(_ABOUT):
        i, j = np.nonzero(vertex[..., k] >= 0)
        number, y, x = vertex[i, j, k], i + down, j + right
        # The pixel on a corner's left has this corner on its right side, and so on.
        np.maximum.at(most[:, 0], number, covered[y, x, 1] if right else 0.0)
        np.maximum.at(least[:, 0], number, 0.0 if right else covered[y, x, 0])
        np.maximum.at(most[:, 1], number, covered[y, x, 3] if down else 0.0)
        np.maximum.at(least[:, 1], number, 0.0 if down else covered[y, x, 2])
    return np.where((most > 0) & (least > 0), 0.0, most - least)  # Opposite moves cancel.


def _pixel_corners(
    vertex: Int[np.ndarray, "h1 w1 4"], solid: Bool[np.ndarray, "h w"]
) -> Int[np.ndarray, "h w 4"]:
    """Return the vertices of each pixel, counter-clockwise from the upper left; -1 if not solid."""
    corners = [vertex[:-1, :-1, 3], vertex[1:, :-1, 1], vertex[1:, 1:, 0], vertex[:-1, 1:, 2]]
    return np.where(solid[..., None], np.stack(corners, axis=-1), -1)


def _rim(
    corners: Int[np.ndarray, "h w 4"],
) -> tuple[Int[np.ndarray, "e 2"], Bool[np.ndarray, "h w"]]:
    """Return the sides of pixels that no neighbour shares, and a mask of pixels with such a side.

    The two vertices of a side are in the order of the pixel's own faces.
    """
    around = np.pad(corners, ((1, 1), (1, 1), (0, 0)), constant_values=-1)
    height, width = corners.shape[:2]
    rim, beside_rim = [], corners[..., 0] < 0
    # A neighbour that shares a side has the two corners of the side in the opposite order.
    for side, (down, right) in enumerate(((0, -1), (1, 0), (0, 1), (-1, 0))):
        beside = around[1 + down : 1 + down + height, 1 + right : 1 + right + width]
        own = corners[..., [side, (side + 1) % 4]]
        lonely = (own != beside[..., [(side + 3) % 4, (side + 2) % 4]]).any(axis=-1)
        rim.append(own[lonely & (own[..., 0] >= 0)])
        beside_rim = beside_rim | lonely
    return np.concatenate(rim), beside_rim


def _blocks(
    corners: Int[np.ndarray, "h w 4"], planes: Planes, beside_rim: Bool[np.ndarray, "h w"]
) -> Int[np.ndarray, "n 4"]:
    """Return the vertices of the surface's rectangles: single pixels, or blocks where it is flat.

    Four squares are joined if their mean planes are within `_FLAT_M` of the mean plane of all
    four. Where small squares meet a large square, their vertices are off its side by at most
    about `_FLAT_M`, and only along the camera's rays, so the camera sees no crack.
    """
    rectangles = [corners[beside_rim & (corners[..., 0] >= 0)]]
    whole, mean, size = ~beside_rim, planes, 1  # state of all squares of the current size
    while whole.any():
        joined, larger = _joined(whole, mean, size)
        rows, columns = (2 * n for n in joined.shape)
        left = whole.copy()
        left[:rows, :columns] &= ~np.kron(joined, np.ones((2, 2), dtype=bool))
        i, j = size * np.array(np.nonzero(left))
        low, right = i + size - 1, j + size - 1
        of_pixels = [(i, j, 0), (low, j, 1), (low, right, 2), (i, right, 3)]
        rectangles.append(np.stack([corners[place] for place in of_pixels], axis=-1))
        whole, mean, size = joined, larger, 2 * size
    return np.concatenate(rectangles)


def _joined(
    whole: Bool[np.ndarray, "h w"], mean: Planes, size: int
) -> tuple[Bool[np.ndarray, "h2 w2"], Float[np.ndarray, "h2 w2 3"]]:
    """Return a mask of the groups of four squares to join, and the mean plane of each group."""
    rows, columns = (n // 2 for n in whole.shape)
    four = mean[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 3)
    larger: np.ndarray = four.mean(axis=(1, 3))
    squares = whole[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2)
    joined: np.ndarray = squares.min(axis=(1, 3))
    if 2 * size > _LARGEST_PX:
        return np.zeros_like(joined), larger
    for down in (0, 1):
        for right in (0, 1):
            at_px = np.array([1.0, size * (right - 0.5), size * (down - 0.5)])
            with np.errstate(invalid="ignore", divide="ignore"):  # A comparison with NaN is False.
                off_m = np.abs(1 / four[:, down, :, right, 0] - 1 / (larger @ at_px))
                joined = joined & (off_m < _FLAT_M)
    return joined, larger


def _at(ground_m: Float[np.ndarray, "h w"], pixel: Float[np.ndarray, "v 2"]) -> np.ndarray:
    """Interpolate the ground's depth at positions [px]; gaps take the nearest known depth."""
    unknown = ~np.isfinite(ground_m)
    if unknown.all():
        return np.zeros(len(pixel))
    filled = from_nearest(ground_m, unknown) if unknown.any() else ground_m
    return ndimage.map_coordinates(filled, pixel[:, ::-1].T, order=1, mode="nearest")


def from_nearest(image: np.ndarray, missing: Bool[np.ndarray, "_ _"]) -> np.ndarray:
    """Return the image with each missing value replaced by the nearest known value."""
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return image[tuple(nearest)]
