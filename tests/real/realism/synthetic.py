"""Closed-form depth maps of planes, and of plates in front of a wall with shadows."""

import numpy as np

from graycast.base.frames import pixel_grid
from graycast.real.realism import DepthScan

HEIGHT_PX, WIDTH_PX = 240, 320
K = np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]])
WALL_M = 1.0


def rays(height_px=HEIGHT_PX, width_px=WIDTH_PX):
    pixel = pixel_grid(height_px, width_px)
    x, y = (pixel[..., 0] - K[0, 2]) / K[0, 0], (pixel[..., 1] - K[1, 2]) / K[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def plane(tilt_rad=0.0, distance_m=0.5, height_px=HEIGHT_PX, width_px=WIDTH_PX):
    """Return z of a plane through (0, 0, distance) that is rotated about y by the tilt."""
    normal = np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    return distance_m * normal[2] / (rays(height_px, width_px) @ normal)


def scan(depth_m, **fields):
    return DepthScan(**({"name": "synthetic", "depth_m": depth_m, "K": K} | fields))


def plates(projector_m, plate_m, wall_m=WALL_M):
    """Return depth of plates (left, top, right, bottom, z) [m] in front of a wall; NaN in shadow.

    A pixel is lit if the straight line from its point to the projector hits no plate.
    """
    ray = rays()
    depth_m = np.full(ray.shape[:2], wall_m)
    for left, top, right, bottom, z in plate_m:
        x, y = ray[..., 0] * z, ray[..., 1] * z
        hit = (x > left) & (x < right) & (y > top) & (y < bottom) & (z < depth_m)
        depth_m[hit] = z
    point = ray * depth_m[..., None]
    lit = np.ones(depth_m.shape, dtype=bool)
    for left, top, right, bottom, z in plate_m:
        way = (z - point[..., 2]) / (projector_m[2] - point[..., 2])
        x, y = (point[..., i] + way * (projector_m[i] - point[..., i]) for i in (0, 1))
        lit &= ~((way > 1e-6) & (x > left) & (x < right) & (y > top) & (y < bottom))
    return np.where(lit, depth_m, np.nan)


def scattered_plates(rng, count=10):
    """Return plates so far apart that no shadow falls on another plate."""
    result = []
    for i in range(count):
        x, y = -0.4 + 0.2 * (i % 5), -0.22 + 0.3 * (i // 5)
        z = WALL_M - rng.uniform(0.1, 0.22)
        wide, high = rng.uniform(0.05, 0.08, size=2)
        result.append((z * x, z * y, z * x + wide, z * y + high, z))
    return result
