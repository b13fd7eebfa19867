"""A wall with a texture that moves in front of a scanner: exact pictures."""

from dataclasses import replace

import numpy as np

from graycast.base.frames import axis_rotation, inverse, rigid, transform_points
from graycast.rig.optics import picture_rays, points, project
from graycast.rig.pair import preset_rig

WALL_M = np.array([0.1, 0.05, 1.0]), 0.8  # Normal direction and distance along the camera's axis


def window_rig(width_px, height_px):
    """Return a window of the camera of a PhoXi M, with a range of 0.7 to 0.9 m."""
    rig = preset_rig("like-phoxi-m", "small")
    window = {"width_px": width_px, "height_px": height_px}
    middle = {"cx_px": width_px / 2, "cy_px": height_px / 2}
    return replace(rig, camera=replace(rig.camera, **window, **middle), near_m=0.7, far_m=0.9)


def wall_depth(camera, normal, distance_m):
    """Return the depth of each pixel on the plane `normal . x = distance_m normal[2]`."""
    return distance_m * normal[2] / (picture_rays(camera) @ normal)


def slope(own_m):
    """Return a brightness that increases along the wall's x."""
    return 1 + own_m[..., 0]


def spots(own_m):
    """Return spots of brightness, about 20 mm apart."""
    return 1 + 0.4 * np.sin(300 * own_m[..., 0]) * np.sin(250 * own_m[..., 1] + 1)


def pictures_of_wall(rig, code, T_then_now, texture=slope):
    """Return exact pictures of a wall that moves, from the geometry of each picture alone."""
    normal, distance_m = WALL_M
    frames = []
    for k, T in enumerate(T_then_now):
        moved_normal = T[:3, :3] @ normal
        on_wall = transform_points(T, np.array([0.0, 0.0, distance_m]))
        depth_m = (moved_normal @ on_wall) / (picture_rays(rig.camera) @ moved_normal)
        place = project(
            rig.projector, transform_points(inverse(rig.T_cam_proj), points(rig.camera, depth_m))
        )
        frame = code.frames[k]
        share = code.share(frame)
        axis = 0 if frame.axis == "column" else 1
        light = np.interp(place[..., axis], np.arange(len(share)), share) if frame.axis else share
        own_m = transform_points(inverse(T), points(rig.camera, depth_m))
        frames.append(texture(own_m) * (2_000 + 30_000 * light))
    return np.round(frames).astype(np.uint16)


def motions(count, velocity_m, turn_rad):
    """Return `T_then_now` of a steady motion; the middle picture has the reference time."""
    steps = np.arange(count) - count // 2
    return np.stack(
        [rigid(axis_rotation("z", turn_rad * s), np.array(velocity_m) * s) for s in steps]
    )
