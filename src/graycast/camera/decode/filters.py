"""Filters of a depth map: flying pixels, outliers, edges, islands, smoothing, order.

They run in that order; each sees what the ones before it left. None makes depth where there was
none. Smoothing and the outlier test work on inverse depth, which is linear along a line of pixels
on a plane: a plane's pixel is the mean of two opposite neighbours, however steep the plane.

Leaves out: lens distortion, whose share in the angle between neighbouring rays is small.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field

from ...base.settings import check_fields
from ...rig.optics import Optics
from ...rig.pair import Rig
from .maps import DepthMap, Reason
from .outliers import find_outliers
from .visibility import without_hidden

STEP_SIGMAS = 3.0  # Noise up to here neither tears a surface nor makes it steep.
LINE_SIGMAS = 4.0  # A pixel farther off the line of two neighbours is not smoothed with them.
FLYING_REACH_PX = 3  # A fall that takes more pixels than this to a side is a surface, not a step.
NEGLIGIBLE_WEIGHT = 0.01  # The smoothing kernel ends at this share of its middle's weight.


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSpec:
    """The settings of the filters; None or 0 switches a filter off, and all are off by default.

    `edge_px` of 1 takes the four sides of a pixel, 1.5 its corners too. `smoothing_px` of 0.55 lets
    0.56 of white noise pass and correlates neighbours by 0.36. `without_hidden` uses
    `hidden_sigmas`; an outlier is judged by the deviations that its neighbours have or show.
    """

    flying_angle_deg: Annotated[
        float | None,
        Field(
            ge=0,
            lt=90,
            description="Pixels between two surfaces are removed if the line of sight meets "
            "the step at more than this angle, in degrees from the normal.",
        ),
    ] = None
    outlier_sigmas: Annotated[
        float | None,
        Field(
            ge=0,
            description="Pixels are removed whose depth differs from their neighbours by "
            "more than this number of standard deviations.",
        ),
    ] = None
    outlier_share: Annotated[
        float,
        Field(
            ge=0,
            description="An outlier must also differ from its neighbours by "
            "more than this share of its depth.",
        ),
    ] = 3e-4
    outlier_repair: Annotated[
        bool,
        Field(
            description="Whether an outlier within a surface gets the depth of that surface "
            "instead of being removed.",
        ),
    ] = False
    hidden_sigmas: Annotated[
        float | None,
        Field(
            ge=0,
            description="Pixels are removed that a nearer surface hides from the projector "
            "by more than this number of standard deviations.",
        ),
    ] = None
    edge_px: Annotated[
        float | None,
        Field(
            ge=0,
            le=5,
            description="Pixels are removed whose distance to a depth step or to a pixel without "
            "depth is at most this number of pixels. 1 removes the pixels on the border of each "
            "surface.",
        ),
    ] = None
    island_px: Annotated[
        int | None,
        Field(ge=0, description="Connected surfaces of fewer pixels than this are removed."),
    ] = None
    smoothing_px: Annotated[
        float | None,
        Field(ge=0, le=10, description="Standard deviation of the smoothing kernel in pixels."),
    ] = None
    step_angle_deg: Annotated[
        float,
        Field(
            gt=0,
            lt=90,
            description="Neighbouring pixels belong to two surfaces if the surface through "
            "both is seen at more than this angle, in degrees from the normal.",
        ),
    ] = 80.0

    def __post_init__(self) -> None:
        check_fields(self)


def filter_depth(depth: DepthMap, spec: FilterSpec, rig: Rig) -> DepthMap:
    """Remove unreliable pixels, and smooth the others.

    Args:
        depth: z and its standard deviation [m]; the noise of pixels is taken as independent.
        rig: the camera whose pixels these are, and the projector that may not light all of them.

    Returns:
        A depth map in which filtered pixels are NaN with `Reason.OUTLIER`, and `sigma_m` is that
        of the smoothed depth; the same map where no filter is on.

    Raises:
        ValueError: the map has another size than the camera's picture, or depth without a standard
            deviation.
    """
    filtered = _filter_surfaces(depth, spec, rig.camera)
    if spec.hidden_sigmas:
        filtered = without_hidden(filtered, rig, sigmas=spec.hidden_sigmas)
    return filtered


def depth_steps(depth: DepthMap, camera: Optics, *, angle_deg: float) -> Bool[np.ndarray, "2 h w"]:
    """Whether each pixel's right neighbour, and its lower one, belongs to another surface.

    Args:
        angle_deg: the surface through both would be seen at more than this angle of incidence.
    """
    z_m, sigma_m = _framed(depth.depth_m, 1), _framed(depth.sigma_m, 1)
    fall = np.zeros((2, *z_m.shape), dtype=np.int8)
    _falls(z_m, sigma_m, _rays(camera, 1), math.tan(math.radians(angle_deg)), fall)
    return fall[:, 1:-1, 1:-1] != 0


def _filter_surfaces(depth: DepthMap, spec: FilterSpec, camera: Optics) -> DepthMap:
    """What each pixel's surroundings in the map tell: flying pixels to smoothing."""
    h, w = depth.depth_m.shape
    if (h, w) != (camera.height_px, camera.width_px):
        size = f"{camera.width_px} x {camera.height_px}"
        raise ValueError(f"the depth map is {w} x {h} px, the rig's camera {size} px")
    if np.isnan(depth.sigma_m[np.isfinite(depth.depth_m)]).any():
        raise ValueError("sigma_m is NaN at pixels that have depth; give every depth its sigma_m")
    kernel = _half_kernel(spec.smoothing_px or 0.0)
    widest_px = max(kernel[:, :2].max(initial=0), spec.edge_px or 0)
    margin_px = max(FLYING_REACH_PX + 2, int(widest_px))
    z_m, sigma_m = _framed(depth.depth_m, margin_px), _framed(depth.sigma_m, margin_px)
    rays = _rays(camera, margin_px)
    step_tan = math.tan(math.radians(spec.step_angle_deg))
    removed = np.zeros((h, w), dtype=np.bool_)
    if spec.flying_angle_deg:
        flying_tan = math.tan(math.radians(spec.flying_angle_deg))
        _flying(z_m, sigma_m, rays, flying_tan, margin_px, removed)
        _erase(z_m, removed, margin_px)
    if spec.outlier_sigmas:
        limits = np.float64(spec.outlier_sigmas), np.float64(spec.outlier_share)
        level, spread = find_outliers(
            *_inverse(z_m, sigma_m), *limits, margin_px, spec.outlier_repair, removed
        )
        _repair(z_m, sigma_m, level, spread, margin_px)
        _erase(z_m, removed, margin_px)
    if spec.edge_px:
        around = _half_disc(spec.edge_px)
        _edges(z_m, sigma_m, rays, step_tan, around, margin_px, removed)
        _erase(z_m, removed, margin_px)
    if spec.island_px:
        _islands(z_m, sigma_m, rays, step_tan, spec.island_px, margin_px, removed)
        _erase(z_m, removed, margin_px)
    inside = np.s_[margin_px : margin_px + h, margin_px : margin_px + w]
    filtered_m, filtered_sigma_m = z_m[inside].copy(), sigma_m[inside].copy()
    if len(kernel):
        filtered_m, filtered_sigma_m = np.empty((2, h, w), dtype=np.float32)
        maps = z_m, sigma_m, *_inverse(z_m, sigma_m)
        _smooth(*maps, rays, step_tan, kernel, margin_px, filtered_m, filtered_sigma_m)
    else:
        filtered_sigma_m[removed] = np.nan
    reason = np.where(removed, np.uint8(Reason.OUTLIER), depth.reason)
    return replace(depth, depth_m=filtered_m, sigma_m=filtered_sigma_m, reason=reason)


def _framed(image: Float[np.ndarray, "h w"], margin_px: int) -> Float[np.ndarray, "H W"]:
    """The map with a border of NaN, so that no loop needs a special case."""
    h, w = image.shape
    framed = np.full((h + 2 * margin_px, w + 2 * margin_px), np.nan, dtype=np.float32)
    framed[margin_px : margin_px + h, margin_px : margin_px + w] = image
    return framed


def _erase(framed: Float[np.ndarray, "H W"], removed: np.ndarray, margin_px: int) -> None:
    h, w = removed.shape
    framed[margin_px : margin_px + h, margin_px : margin_px + w][removed] = np.nan


def _repair(z_m, sigma_m, level, spread, margin_px: int) -> None:
    """Write the surfaces' inverse depth and its deviation into pixels that have one."""
    h, w = level.shape
    inside = np.s_[margin_px : margin_px + h, margin_px : margin_px + w]
    known = ~np.isnan(level)
    z_m[inside][known] = 1 / level[known]
    sigma_m[inside][known] = spread[known] / level[known] ** 2


def _inverse(
    z_m: Float[np.ndarray, "H W"], sigma_m: Float[np.ndarray, "H W"]
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth [1/m] and its standard deviation."""
    inverse = np.float32(1) / z_m
    return inverse, sigma_m * inverse * inverse


def _rays(camera: Optics, margin_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Ray slopes x / z of the framed columns and y / z of the framed rows."""
    column = np.arange(-margin_px, camera.width_px + margin_px)
    row = np.arange(-margin_px, camera.height_px + margin_px)
    return (column - camera.cx_px) / camera.fx_px, (row - camera.cy_px) / camera.fy_px


def _half_kernel(smoothing_px: float) -> Float[np.ndarray, "n 3"]:
    """(dy, dx, weight) of one of each two opposite neighbours; the middle, not in it, has 1."""
    if smoothing_px == 0:
        return np.empty((0, 3))
    radius = math.ceil(smoothing_px * math.sqrt(-2 * math.log(NEGLIGIBLE_WEIGHT)))
    side = range(-radius, radius + 1)
    offsets = np.array([(dy, dx) for dy in side for dx in side if (dy, dx) > (0, 0)], dtype=float)
    weight = np.exp(-np.square(offsets).sum(axis=1) / (2 * smoothing_px**2))
    return np.column_stack([offsets, weight])[weight >= NEGLIGIBLE_WEIGHT]


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _steepness(z, sigma, rays, y, x, v, u, limit_tan):
    """-1 or 1 where pixel (v, u) lies before or behind (y, x) at more than that incidence, else 0.

    The way between the two has a part along the first one's ray and one across it, here both
    times the ray's length; `along > limit_tan across` by more than noise is steep. NaN is 0.
    """
    ray_x, ray_y = rays[0][x], rays[1][y]
    dx, dy = rays[0][u] - ray_x, rays[1][v] - ray_y
    length2 = 1.0 + ray_x * ray_x + ray_y * ray_y
    toward = dx * ray_x + dy * ray_y
    other = np.float64(z[v, u])
    along = other * toward + (other - z[y, x]) * length2
    across2 = other * other * ((dx * dx + dy * dy) * length2 - toward * toward)
    if not along * along > limit_tan * limit_tan * across2:  # almost always, and without a root
        return 0
    noise = math.sqrt(sigma[y, x] * sigma[y, x] + sigma[v, u] * sigma[v, u]) * length2
    if abs(along) > limit_tan * math.sqrt(across2) + STEP_SIGMAS * noise:
        return 1 if along > 0 else -1
    return 0


# --- flying pixels -----------------------------------------------------------------------------


def _flying(z_m, sigma_m, rays, flying_tan, margin_px: int, removed) -> None:
    fall = np.zeros((2, *z_m.shape), dtype=np.int8)
    _falls(z_m, sigma_m, rays, flying_tan, fall)
    _hanging(z_m, sigma_m, rays, flying_tan, fall, margin_px, removed)


@numba.njit(parallel=True, cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _falls(z, sigma, rays, limit_tan, fall):
    """Steepness from each pixel of the frame to the next one, rightwards and downwards."""
    for row in numba.prange(z.shape[0] - 1):
        y = np.int64(row)  # parallel loops count without a sign: more versions would be compiled
        for x in range(z.shape[1] - 1):
            fall[0, y, x] = _steepness(z, sigma, rays, y, x, y, x + 1, limit_tan)
            fall[1, y, x] = _steepness(z, sigma, rays, y, x, y + 1, x, limit_tan)


@numba.njit(parallel=True, cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _hanging(z, sigma, rays, flying_tan, fall, margin, removed):
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
                    z, sigma, rays, flying_tan, y, x, down * (first - last), right * (first - last)
                ):
                    removed[row, column] |= _within_step(
                        z, fall[axis], y, x, down, right, first, last
                    )


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _goes_on(z, sigma, rays, flying_tan, y, x, down, right):
    """Whether the surface of a pixel continues beyond a small hole."""
    for k in range(2, FLYING_REACH_PX + 1):
        v, u = y + k * down, x + k * right
        if not np.isnan(z[v, u]):
            return _steepness(z, sigma, rays, y, x, v, u, flying_tan) == 0
    return False


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _within_step(z, fall, y, x, down, right, first, last):
    """Whether the fall around a pixel is a step: it ends soon, between much flatter surfaces.

    A smooth surface stays, then, even where it is steeper than the limit. `first` and `last` are
    the pixels that the fall is known to reach to either side; an empty side (0) has no surface.
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
    # What is empty is NaN, which is not steep.
    return not (abs(start - outer_start) > flat or abs(end - outer_end) > flat)


# --- edges -------------------------------------------------------------------------------------


def _half_disc(radius_px: float) -> Int[np.ndarray, "n 2"]:
    """(dy, dx) of one of each two opposite neighbours within a distance."""
    side = range(-int(radius_px), int(radius_px) + 1)
    return np.array(
        [
            (dy, dx)
            for dy in side
            for dx in side
            if (dy, dx) > (0, 0) and dy**2 + dx**2 <= radius_px**2
        ]
    )


@numba.njit(parallel=True, cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _edges(z, sigma, rays, step_tan, around, margin, removed):
    """Mark pixels beside a step or a pixel without depth; the picture's own border is none."""
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
                        edge |= _steepness(z, sigma, rays, y, x, v, u, step_tan) != 0
                        removed[row, column] |= edge


# --- islands -----------------------------------------------------------------------------------


def _islands(z_m, sigma_m, rays, step_tan, island_px: int, margin_px: int, removed) -> None:
    """Remove surfaces smaller than `island_px`, connected over the four sides of a pixel."""
    h, w = removed.shape
    torn = np.zeros((2, *z_m.shape), dtype=np.int8)
    _falls(z_m, sigma_m, rays, step_tan, torn)
    parent = np.arange(h * w, dtype=np.int32)
    _unite(z_m, torn, margin_px, w, parent)
    inside = z_m[margin_px : margin_px + h, margin_px : margin_px + w]
    size = np.bincount(parent, minlength=h * w)[parent].reshape(h, w)
    removed |= (size < island_px) & ~np.isnan(inside)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _unite(z, torn, margin, w, parent):
    """Every pixel gets the lowest index of its island: union-find (Tarjan, 1975)."""
    for i in range(len(parent)):
        y, x = i // w + margin, i % w + margin
        if np.isnan(z[y, x]):
            continue
        if not np.isnan(z[y, x - 1]) and not torn[0, y, x - 1]:
            parent[i] = _root(parent, i - 1)
        if not np.isnan(z[y - 1, x]) and not torn[1, y - 1, x]:
            a, b = _root(parent, i), _root(parent, i - w)
            parent[max(a, b)] = min(a, b)
    for i in range(len(parent)):
        parent[i] = parent[parent[i]]  # parents have lower indices: they are roots by now


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


# --- smoothing ---------------------------------------------------------------------------------


@numba.njit(parallel=True, cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _smooth(z, sigma, inverse, noise, rays, step_tan, kernel, margin, smooth, smooth_sigma):
    """Opposite neighbours enter in pairs, so that a plane's border is not pulled inwards."""
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
                # On the line of both, a pixel is as steep to one as to the other. NaN is not <=.
                if off * off <= LINE_SIGMAS**2 * (own + 0.25 * pair) and (
                    _steepness(z, sigma, rays, y, x, y + dy, x + dx, step_tan) == 0
                ):
                    level += 2.0 * weight * line
                    variance += weight * weight * pair
                    total += 2.0 * weight
            smooth[row, column] = total / level
            smooth_sigma[row, column] = math.sqrt(variance) * total / (level * level)
