"""A window of a depth map with smoothed depth and surface normals."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32

from ..base.kernels import kernel
from ..base.mask_box import mask_box
from ..base.robust import robust_sigma
from ..rig.optics import Optics, rays

OUTLIER_SIGMAS = 2.5  # The second fit leaves out neighbours this many sigmas from the first plane.
LEAST_SHARE = 0.4  # A window has a normal only if this share of its pixels is on one surface.
ROUNDING = 1e-6  # Neighbours nearer to the plane than this share of the depth are no outliers.
STEEP = 3.0  # Steepest surface [depth per width]: its normal is 72 degrees from the ray.


@dataclass(frozen=True, slots=True, kw_only=True)
class Crop:
    """A window of a depth map, whose first pixel is (left_px, top_px) of the picture.

    Attributes:
        ray: x and y of the ray of each pixel, scaled to unit z.
        z: measured depth [m]; NaN without a measurement.
        smooth: depth of the plane that fits the neighbours [m]; NaN without a plane.
        normal: unit normal of that plane, towards the camera.
        inside: mask of the detection's pixels.
        tight: whether the mask is the outline of the part and not only a box around it.
        noise_m: robust standard deviation of the measured depth from these planes.
    """

    left_px: int
    top_px: int
    camera: Optics
    ray: Float[np.ndarray, "h w 2"]
    z: Float[np.ndarray, "h w"]
    smooth: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    inside: Bool[np.ndarray, "h w"]
    tight: bool
    noise_m: float

    def __post_init__(self) -> None:
        for name in ("ray", "z", "smooth", "normal", "inside"):
            getattr(self, name).flags.writeable = False


def crop(
    depth_m: Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"],
    camera: Optics,
    inside: Bool[np.ndarray, "h w"],
    *,
    tight: bool,
    reach_m: float,
    window_m: float,
) -> Crop | None:
    """Return the surroundings of a detection, or None if no pixel of the detection has a depth.

    Args:
        reach_m: distance to which the part may extend beyond the detection.
        window_m: half the width of the windows in which planes are fitted.
    """
    x, y, columns, rows = mask_box(inside)
    box = np.s_[y : y + rows, x : x + columns]
    depths_m = depth_m[box][inside[box]]
    depths_m = depths_m[np.isfinite(depths_m)]
    if not len(depths_m):
        return None
    f_px = math.sqrt(camera.fx_px * camera.fy_px)
    middle_m = float(np.median(depths_m))
    beyond = math.ceil(reach_m / middle_m * f_px)
    top, bottom = max(y - beyond, 0), min(y + rows + beyond, camera.height_px)
    left, right = max(x - beyond, 0), min(x + columns + beyond, camera.width_px)
    v, u = np.mgrid[top:bottom, left:right].astype(np.float64)
    ray = np.ascontiguousarray(rays(camera, np.stack([u, v], axis=-1))[..., :2])
    z = depth_m[top:bottom, left:right].astype(np.float64)
    radius_px = int(np.clip(round(window_m / middle_m * f_px), 2, 12))
    spacing_m = middle_m / f_px
    inside = inside[top:bottom, left:right].copy()
    smooth, normal, off = _planes(z, ray, radius_px, STEEP * spacing_m * radius_px)
    off = off[inside & np.isfinite(off)]
    noise_m = float(robust_sigma(off))
    return Crop(
        left_px=int(left),
        top_px=int(top),
        camera=camera,
        ray=ray,
        z=z,
        smooth=smooth,
        normal=normal,
        inside=inside,
        tight=tight,
        noise_m=noise_m,
    )


@kernel(nogil=True, error_model="numpy")
def _planes(z, ray, radius, jump_m):
    """Fit a plane around each pixel by least squares of inverse depth.

    On the plane `a X + b Y + c Z = 1`, inverse depth is linear in the image: `a x + b y + c`.
    A second fit leaves out the outliers of the first.
    """
    h, w = z.shape
    smooth, off = np.full((h, w), np.nan), np.full((h, w), np.nan)
    normal = np.full((h, w, 3), np.nan)
    stride = 1 + radius // 5
    count = (2 * (radius // stride) + 1) ** 2
    q, x, y = np.empty(count), np.empty(count), np.empty(count)
    for i in range(h):
        for j in range(w):
            z0 = z[i, j]
            if not z0 > 0:
                continue
            n = 0
            for di in range(-(radius // stride) * stride, radius + 1, stride):
                for dj in range(-(radius // stride) * stride, radius + 1, stride):
                    r, s = i + di, j + dj
                    if r < 0 or s < 0 or r >= h or s >= w:
                        continue
                    if abs(z[r, s] - z0) < jump_m:  # False for NaN
                        q[n] = 1 / z[r, s]
                        x[n] = ray[r, s, 0] - ray[i, j, 0]
                        y[n] = ray[r, s, 1] - ray[i, j, 1]
                        n += 1
            a, b, c, limit = 0.0, 0.0, 0.0, np.inf
            for second in range(2):
                if n < LEAST_SHARE * count or n < 5:
                    n = 0
                    break
                a, b, c = _fit(q, x, y, n)
                total = 0.0
                for k in range(n):
                    total += (q[k] - a * x[k] - b * y[k] - c) ** 2
                limit = max(OUTLIER_SIGMAS * math.sqrt(total / n), ROUNDING * c)
                if second == 0:
                    rest = 0
                    for k in range(n):
                        if abs(q[k] - a * x[k] - b * y[k] - c) <= limit:
                            q[rest], x[rest], y[rest] = q[k], x[k], y[k]
                            rest += 1
                    n = rest
            if n == 0 or not c > 0 or abs(1 / z0 - c) > 2 * limit:
                continue
            tilt = c - a * ray[i, j, 0] - b * ray[i, j, 1]
            length = math.sqrt(a * a + b * b + tilt * tilt)
            smooth[i, j], off[i, j] = 1 / c, abs(z0 - 1 / c)
            normal[i, j, 0], normal[i, j, 1] = -a / length, -b / length
            normal[i, j, 2] = -tilt / length
    return smooth, normal, off


@kernel(nogil=True, error_model="numpy")
def _fit(q, x, y, n):
    """Return a, b and c of the best fit `q = a x + b y + c`; c is -1 without a fit."""
    qm, xm, ym = 0.0, 0.0, 0.0
    for k in range(n):
        qm, xm, ym = qm + q[k], xm + x[k], ym + y[k]
    qm, xm, ym = qm / n, xm / n, ym / n
    xx, xy, yy, xq, yq = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        u, v, p = x[k] - xm, y[k] - ym, q[k] - qm
        xx, xy, yy, xq, yq = xx + u * u, xy + u * v, yy + v * v, xq + u * p, yq + v * p
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6 * xx * yy:
        return 0.0, 0.0, -1.0  # Points on one line define no plane.
    a = (xq * yy - yq * xy) / determinant
    b = (yq * xx - xq * xy) / determinant
    return a, b, qm - a * xm - b * ym
