"""Smooth normals of a depth map: a plane through the widest window that is flat within the noise.

A plane `n . p = d` in the camera frame is linear in inverse depth: `1/z = (n/d) . (x, y, 1)` at the
normalised coordinates (x, y). So a linear regression of 1/z in a window gives the normal, and its
residuals give the normal's standard deviation.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter

from ...rig.optics import Optics, picture_rays

RADII_PX = (8, 6, 4, 3, 2)  # Half sides of the windows, the widest first.
FILLED = 0.6  # A window needs depth in at least this share of its pixels.
FLAT = 1.3  # A large window is flat if its residuals are at most this many times the noise.
SPREAD = 1.5  # Chance may raise the residuals of a window of n pixels by this over root n.


@dataclass(frozen=True, slots=True, kw_only=True)
class Normals:
    """Unit normals towards the camera, in its frame; NaN where no window is flat.

    `sigma_rad` is the standard deviation of a normal about each of two axes, and `area_px` the
    number of pixels that determine it.
    """

    normal: Float[np.ndarray, "h w 3"]
    sigma_rad: Float[np.ndarray, "h w"]
    area_px: Float[np.ndarray, "h w"]


def smooth_normals(
    camera: Optics, depth_m: Float[np.ndarray, "h w"], inside: Bool[np.ndarray, "h w"]
) -> Normals:
    """Return normals of the pixels inside a mask, whose neighbours outside are ignored.

    The noise of 1/z is the median residual of the smallest windows. A window that passes an edge or
    a strong curvature has larger residuals, and the next smaller one is tried.

    Leaves out: noise that is common to neighbours, which makes `sigma_rad` too small.
    """
    known = inside & np.isfinite(depth_m)
    ray = picture_rays(camera)
    inverse_depth = np.divide(1.0, depth_m, out=np.zeros(depth_m.shape), where=known)
    normal = np.full(ray.shape, np.nan)
    sigma_rad, area_px = np.full((2, *depth_m.shape), np.nan)
    fits = {radius: _planes(ray, inverse_depth, known, radius) for radius in RADII_PX}
    smallest = fits[RADII_PX[-1]]
    usable = known & smallest.filled
    if not usable.any():
        return Normals(normal=normal, sigma_rad=sigma_rad, area_px=area_px)
    noise = float(np.median(smallest.residual[usable]))
    left = known.copy()
    for fit in fits.values():
        flat = FLAT * (1 + SPREAD / np.sqrt(np.maximum(fit.count, 1)))
        take = left & fit.filled & (fit.residual <= flat * noise)
        length = np.linalg.norm(fit.plane[take], axis=-1)
        normal[take] = -fit.plane[take] / length[:, None]
        sigma_rad[take] = np.maximum(fit.residual[take], noise) * fit.lever[take] / length
        area_px[take] = fit.count[take]
        left &= ~take
    return Normals(normal=normal, sigma_rad=sigma_rad, area_px=area_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Planes:
    """The plane (n/d) in each window, and the precision with which its pixels determine it."""

    plane: Float[np.ndarray, "h w 3"]
    residual: Float[np.ndarray, "h w"]  # Root mean square of 1/z about the plane [1/m]
    lever: Float[np.ndarray, "h w"]  # Standard deviation of the slopes per residual
    count: Float[np.ndarray, "h w"]
    filled: Bool[np.ndarray, "h w"]


def _planes(
    ray: Float[np.ndarray, "h w 3"],
    inverse_depth: Float[np.ndarray, "h w"],
    known: Bool[np.ndarray, "h w"],
    radius_px: int,
) -> _Planes:
    side = 2 * radius_px + 1
    weight = known.astype(np.float64)
    # Differences from the mean of all pixels keep the sums precise.
    value = np.stack([ray[..., 0], ray[..., 1], inverse_depth])
    value -= np.array([v[known].mean() if known.any() else 0.0 for v in value])[:, None, None]
    share = np.maximum(_mean(weight, side), 1e-12)

    def mean(values: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        return _mean(weight * values, side) / share

    x, y, q = value
    mx, my, mq = mean(x), mean(y), mean(q)
    xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    xq, yq, qq = mean(x * q) - mx * mq, mean(y * q) - my * mq, mean(q * q) - mq * mq
    det = xx * yy - xy * xy
    count = share * side * side
    filled = known & (share >= FILLED) & (det > 1e-3 * xx * yy)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (yy * xq - xy * yq) / det, (xx * yq - xy * xq) / det
        square = np.maximum(qq - a * xq - b * yq, 0) * count / np.maximum(count - 3, 1)
        lever = np.sqrt((xx + yy) / (2 * det * count))
        on_axis = mean(inverse_depth) - a * mean(ray[..., 0]) - b * mean(ray[..., 1])
    return _Planes(
        plane=np.stack([a, b, on_axis], axis=-1),
        residual=np.sqrt(square),
        lever=lever,
        count=count,
        filled=filled,
    )


def _mean(values: Float[np.ndarray, "h w"], side: int) -> Float[np.ndarray, "h w"]:
    return uniform_filter(values, side, mode="constant")
