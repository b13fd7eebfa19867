"""Views of planes and spheres whose depth is a closed form, for tests of merging."""

import numpy as np

from graycast.base.frames import look_at, pixel_grid
from graycast.rig.optics import Optics, rays
from graycast.score.merge.view import MeasuredView

CAMERA = Optics(width_px=80, height_px=60, fx_px=100.0, fy_px=100.0, cx_px=39.5, cy_px=29.5)
FINE = Optics(width_px=320, height_px=240, fx_px=400.0, fy_px=400.0, cx_px=159.5, cy_px=119.5)


def from_above(x_m, y_m=0.0, z_m=1.0):
    """Return a camera that looks at the origin."""
    return look_at(np.array([x_m, y_m, z_m]), np.zeros(3), np.array([0.0, -1.0, 0.0]))


def world_rays(T_world_cam, camera=CAMERA):
    ray = rays(camera, pixel_grid(camera.height_px, camera.width_px))
    return ray @ T_world_cam[:3, :3].T


def plane_depth(T_world_cam, normal, offset_m, camera=CAMERA):
    """Return z on the plane `normal . p = offset_m`; rays have z = 1, so their factor is z."""
    eye = T_world_cam[:3, 3]
    return (offset_m - normal @ eye) / (world_rays(T_world_cam, camera) @ normal)


def sphere_depth(T_world_cam, middle_m, radius_m, camera=CAMERA):
    """Return z of the nearer intersection; NaN where a ray misses the sphere."""
    ray = world_rays(T_world_cam, camera)
    to = T_world_cam[:3, 3] - np.asarray(middle_m)
    a, b = (ray**2).sum(-1), (ray * to).sum(-1)
    inside = b**2 - a * (to @ to - radius_m**2)
    return (-b - np.sqrt(np.where(inside >= 0, inside, np.nan))) / a


def view(depth_m, T_world_cam, sigma_m, *, name="view", reason=None, camera=CAMERA, color=128):
    known = np.isfinite(depth_m)
    reasons = np.zeros(depth_m.shape) if reason is None else np.where(known, 0, reason)
    return MeasuredView(
        name=name,
        camera=camera,
        T_world_cam=T_world_cam,
        depth_m=depth_m,
        sigma_m=np.where(known, sigma_m, np.nan),
        reason=reasons.astype(np.uint8),
        color=np.full((*depth_m.shape, 3), color, dtype=np.uint8),
    )
