"""Filters of a depth map: flying pixels, outliers, edges, islands, smoothing, hidden pixels.

The filters run in this order, each on the result of the previous one. None gives depth to a pixel
without depth. Smoothing and the outlier test use inverse depth, which is linear along a line of
pixels on a plane: a pixel is the mean of two opposite neighbours, even on a steep plane.

Leaves out: lens distortion, which hardly changes the angle between neighbouring rays.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int8

from ...base.kernels import kernel
from ...rig.optics import Optics
from ...rig.pair import Rig
from .maps import DepthMap, FilterSpec
from .outliers import find_outliers
from .reasons import Reason
from .union_find import flatten, sizes, unite
from .visibility import without_hidden

STEP_SIGMAS = 3.0  # A change of depth of less than this many sigmas is neither a step nor steep.
LINE_SIGMAS = 4.0  # A pixel this far from the line of two neighbours is not smoothed with them.
FLYING_REACH_PX = 3  # A slope that extends farther than this to a side is a surface, not a step.
NEGLIGIBLE_WEIGHT = 0.01  # The smoothing kernel is cut off at this share of its central weight.


def filter_depth(depth: DepthMap, spec: FilterSpec, rig: Rig) -> DepthMap:
    """Remove unreliable pixels, and smooth the remaining ones.

    Args:
        depth: z and its standard deviation [m]; the noise of pixels is taken as independent.
        rig: the rig with which the depth was measured.

    Returns:
        A depth map in which removed pixels are NaN with `Reason.OUTLIER`, and `sigma_m` belongs to
        the smoothed depth; the given map if no filter is on.

    Raises:
        ValueError: the map has another size than the camera's picture, or a pixel has a depth but
            no standard deviation.
    """
    filtered = _filter_surfaces(depth, spec, rig.camera)
    if spec.hidden_sigmas:
        filtered = without_hidden(filtered, rig, sigmas=spec.hidden_sigmas)
    return filtered


class _Framed(NamedTuple):
    """A depth map with a border of NaN, so that loops need no special case at the border.

    `ray_x` and `ray_y` are the ray slopes x / z of its columns and y / z of its rows.
    """

    z: Float32[np.ndarray, "H W"]
    sigma: Float32[np.ndarray, "H W"]
    ray_x: Float[np.ndarray, " W"]
    ray_y: Float[np.ndarray, " H"]
    margin: int

    def inside(self, image: Float32[np.ndarray, "H W"]) -> Float32[np.ndarray, "h w"]:
        """Return a view of an image without its border."""
        return image[self.margin : -self.margin, self.margin : -self.margin]

    def erase(self, removed: Bool[np.ndarray, "h w"]) -> None:
        self.inside(self.z)[removed] = np.nan

    def inverse(self) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
        """Return inverse depth [1/m] and its standard deviation."""
        inverse = np.float32(1) / self.z
        return inverse, self.sigma * inverse * inverse


def _framed(depth: DepthMap, camera: Optics, margin_px: int) -> _Framed:
    z, sigma = (
        np.pad(np.asarray(each, np.float32, order="C"), margin_px, constant_values=np.nan)
        for each in (depth.depth_m, depth.sigma_m)
    )
    column = np.arange(-margin_px, camera.width_px + margin_px)
    row = np.arange(-margin_px, camera.height_px + margin_px)
    return _Framed(
        z=z,
        sigma=sigma,
        ray_x=(column - camera.cx_px) / camera.fx_px,
        ray_y=(row - camera.cy_px) / camera.fy_px,
        margin=margin_px,
    )


def _filter_surfaces(depth: DepthMap, spec: FilterSpec, camera: Optics) -> DepthMap:
    """Apply the filters that use only the map, from flying pixels to smoothing."""
    h, w = depth.depth_m.shape
    if (h, w) != (camera.height_px, camera.width_px):
        size = f"{camera.width_px} x {camera.height_px}"
        raise ValueError(f"the depth map is {w} x {h} px, the rig's camera {size} px")
    if np.isnan(depth.sigma_m[np.isfinite(depth.depth_m)]).any():
        raise ValueError("sigma_m is NaN at pixels that have depth; give every depth its sigma_m")
    kernel = _half_kernel(spec.smoothing_px) if spec.smoothing_px else np.empty((0, 3))
    widest_px = max(kernel[:, :2].max(initial=0), spec.edge_px or 0)
    framed = _framed(depth, camera, max(FLYING_REACH_PX + 2, int(widest_px)))
    step_tan = math.tan(math.radians(spec.step_angle_deg))
    removed = np.zeros((h, w), dtype=np.bool_)
    if spec.flying_angle_deg:
        flying_tan = math.tan(math.radians(spec.flying_angle_deg))
        _hanging(framed, flying_tan, _falls_of(framed, flying_tan), removed)
        framed.erase(removed)
    if spec.outlier_sigmas:
        surface = np.full((2, h, w), np.nan)
        limits = np.float64(spec.outlier_sigmas), np.float64(spec.outlier_share)
        find_outliers(
            *framed.inverse(), *limits, framed.margin, spec.outlier_repair, removed, surface
        )
        level, spread = surface
        known = ~np.isnan(level)
        framed.inside(framed.z)[known] = 1 / level[known]
        framed.inside(framed.sigma)[known] = spread[known] / level[known] ** 2
        framed.erase(removed)
    if spec.edge_px:
        _edges(framed, step_tan, _half_disc(spec.edge_px), removed)
        framed.erase(removed)
    if spec.island_px:
        _islands(framed, step_tan, spec.island_px, removed)
        framed.erase(removed)
    filtered_m, filtered_sigma_m = np.empty((2, h, w), dtype=np.float32)
    if len(kernel):
        _smooth(framed, *framed.inverse(), step_tan, kernel, filtered_m, filtered_sigma_m)
    else:
        filtered_m[:] = framed.inside(framed.z)
        filtered_sigma_m[:] = np.where(removed, np.float32(np.nan), framed.inside(framed.sigma))
    smooth = replace(depth, depth_m=filtered_m, sigma_m=filtered_sigma_m)
    return smooth.without(removed, Reason.OUTLIER)


def _half_disc(radius_px: float) -> Int[np.ndarray, "n 2"]:
    """Return (dy, dx) of the neighbours within a distance, with one of each opposite pair."""
    side = range(-int(radius_px), int(radius_px) + 1)
    offsets = [
        (dy, dx)
        for dy in side
        for dx in side
        if (dy, dx) > (0, 0) and dy**2 + dx**2 <= radius_px**2
    ]
    return np.array(offsets, dtype=np.int64).reshape(-1, 2)


def _half_kernel(smoothing_px: float) -> Float[np.ndarray, "n 3"]:
    """Return (dy, dx, weight) of one pixel of each opposite pair; the central weight is 1."""
    offsets = _half_disc(smoothing_px * math.sqrt(-2 * math.log(NEGLIGIBLE_WEIGHT)))
    weight = np.exp(-np.square(offsets).sum(axis=1) / (2 * smoothing_px**2))
    return np.column_stack([offsets, weight])


@kernel()
def _steepness(framed, y, x, v, u, limit_tan):
    """Return -1 if a steep slope leads from (y, x) to a nearer pixel (v, u), 1 if farther, else 0.

    The vector between the points has a component along the first ray and another across it. Both
    are here times the ray's length. If `along > limit_tan across` by more than noise, it is steep.
    """
    z, sigma = framed.z, framed.sigma
    ray_x, ray_y = framed.ray_x[x], framed.ray_y[y]
    dx, dy = framed.ray_x[u] - ray_x, framed.ray_y[v] - ray_y
    length2 = 1.0 + ray_x * ray_x + ray_y * ray_y
    toward = dx * ray_x + dy * ray_y
    other = np.float64(z[v, u])
    along = other * toward + (other - z[y, x]) * length2
    across2 = other * other * ((dx * dx + dy * dy) * length2 - toward * toward)
    if not along * along > limit_tan * limit_tan * across2:  # True for most pixels, and for NaN
        return 0
    noise = math.sqrt(sigma[y, x] * sigma[y, x] + sigma[v, u] * sigma[v, u]) * length2
    if abs(along) > limit_tan * math.sqrt(across2) + STEP_SIGMAS * noise:
        return 1 if along > 0 else -1
    return 0


# --- flying pixels -----------------------------------------------------------------------------


def _falls_of(framed: _Framed, limit_tan: float) -> Int8[np.ndarray, "2 H W"]:
    """Return `_steepness` from each pixel to the next one, rightwards and downwards."""
    fall = np.zeros((2, *framed.z.shape), dtype=np.int8)
    _falls(framed, limit_tan, fall)
    return fall


@kernel(parallel=True)
def _falls(framed, limit_tan, fall):
    for row in numba.prange(fall.shape[1] - 1):
        y = np.int64(row)  # Parallel loops have unsigned counters, for which numba recompiles.
        for x in range(fall.shape[2] - 1):
            fall[0, y, x] = _steepness(framed, y, x, y, x + 1, limit_tan)
            fall[1, y, x] = _steepness(framed, y, x, y + 1, x, limit_tan)


@kernel(parallel=True)
def _hanging(framed, flying_tan, fall, removed):
    z, margin = framed.z, framed.margin
    h, w = removed.shape
    for row in numba.prange(h):
        for column in range(w):
            y, x = row + margin, column + margin
            for axis, down, right in ((0, 0, 1), (1, 1, 0)):
                before, after = fall[axis, y - down, x - right], fall[axis, y, x]
                if before == after == 0:
                    continue
                if before == after:
                    first, last = 1, 1
                elif before == 1 and np.isnan(z[y + down, x + right]):
                    first, last = 1, 0
                elif after == -1 and np.isnan(z[y - down, x - right]):
                    first, last = 0, 1
                else:
                    continue
                if first == last or not _goes_on(
                    framed, flying_tan, y, x, down * (first - last), right * (first - last)
                ):
                    removed[row, column] |= _within_step(
                        z, fall[axis], y, x, down, right, first, last
                    )


@kernel()
def _goes_on(framed, flying_tan, y, x, down, right):
    """Return whether the surface of a pixel continues beyond a small hole."""
    for k in range(2, FLYING_REACH_PX + 1):
        v, u = y + k * down, x + k * right
        if not np.isnan(framed.z[v, u]):
            return _steepness(framed, y, x, v, u, flying_tan) == 0
    return False


@kernel()
def _within_step(z, fall, y, x, down, right, first, last):
    """Return whether the slope around a pixel is a step: short, between much flatter surfaces.

    So a smooth surface is kept even if it is steeper than the limit. `first` and `last` are the
    known extent of the slope to each side, in pixels; 0 means a side without a surface.
    """
    sense = fall[y, x] if last else fall[y - down, x - right]
    while 0 < first <= FLYING_REACH_PX:
        if fall[y - (first + 1) * down, x - (first + 1) * right] != sense:
            break
        first += 1
    while 0 < last <= FLYING_REACH_PX:
        if fall[y + last * down, x + last * right] != sense:
            break
        last += 1
    if max(first, last) > FLYING_REACH_PX:
        return False
    start, end = z[y - first * down, x - first * right], z[y + last * down, x + last * right]
    flat = 0.5 * abs(end - start) / (first + last)
    outer_start = z[y - (first + 1) * down, x - (first + 1) * right]
    outer_end = z[y + (last + 1) * down, x + (last + 1) * right]
    # A pixel without depth is NaN, which compares as not steep.
    return not (abs(start - outer_start) > flat or abs(end - outer_end) > flat)


# --- edges -------------------------------------------------------------------------------------


@kernel(parallel=True)
def _edges(framed, step_tan, around, removed):
    """Mark pixels next to a step or to a pixel without depth, but not at the picture's border."""
    z, margin = framed.z, framed.margin
    h, w = removed.shape
    for row in numba.prange(h):
        for column in range(w):
            y, x = row + margin, column + margin
            if np.isnan(z[y, x]):
                continue
            for k in range(len(around)):
                for way in (-1, 1):
                    v, u = y + way * around[k, 0], x + way * around[k, 1]
                    if margin <= v < h + margin and margin <= u < w + margin:
                        edge = np.isnan(z[v, u])
                        edge |= _steepness(framed, y, x, v, u, step_tan) != 0
                        removed[row, column] |= edge


# --- islands -----------------------------------------------------------------------------------


def _islands(framed: _Framed, step_tan: float, island_px: int, removed) -> None:
    """Mark surfaces of fewer than `island_px` pixels; pixels connect only by their sides."""
    h, w = removed.shape
    parent = np.arange(h * w, dtype=np.int32)
    _unite(framed.z, _falls_of(framed, step_tan), framed.margin, w, parent)
    removed |= (sizes(parent).reshape(h, w) < island_px) & ~np.isnan(framed.inside(framed.z))


@kernel()
def _unite(z, torn, margin, w, parent):
    """Label each pixel with the lowest index in its island."""
    for i in range(len(parent)):
        y, x = i // w + margin, i % w + margin
        if np.isnan(z[y, x]):
            continue
        if not np.isnan(z[y, x - 1]) and not torn[0, y, x - 1]:
            unite(parent, i, i - 1)
        if not np.isnan(z[y - 1, x]) and not torn[1, y - 1, x]:
            unite(parent, i, i - w)
    flatten(parent)


# --- smoothing ---------------------------------------------------------------------------------


@kernel(parallel=True)
def _smooth(framed, inverse, noise, step_tan, kernel, smooth, smooth_sigma):
    """Smooth inverse depth with pairs of opposite neighbours, which does not change a plane."""
    margin = framed.margin
    h, w = smooth.shape
    for row in numba.prange(h):
        for column in range(w):
            y, x = row + margin, column + margin
            middle, own = np.float64(inverse[y, x]), np.float64(noise[y, x]) ** 2
            level, variance, total = middle, own, 1.0
            for k in range(len(kernel)):
                dy, dx, weight = int(kernel[k, 0]), int(kernel[k, 1]), kernel[k, 2]
                line = 0.5 * (np.float64(inverse[y - dy, x - dx]) + inverse[y + dy, x + dx])
                first, second = noise[y - dy, x - dx], noise[y + dy, x + dx]
                pair = first * first + second * second
                off = line - middle
                # On the line of two neighbours, a pixel is equally steep to each; NaN gives False.
                if off * off <= LINE_SIGMAS**2 * (own + 0.25 * pair) and (
                    _steepness(framed, y, x, y + dy, x + dx, step_tan) == 0
                ):
                    level += 2.0 * weight * line
                    variance += weight * weight * pair
                    total += 2.0 * weight
            smooth[row, column] = total / level
            smooth_sigma[row, column] = math.sqrt(variance) * total / (level * level)
