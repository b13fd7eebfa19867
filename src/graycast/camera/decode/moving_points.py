"""Follow the points of a rigid scene, and their light, through the pictures of a code.

The nearness of a point is 0 at the far end of the working range, and 1 at its near end; it is
linear in the inverse of depth, so that places in the projector move almost evenly with it.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from ...base.frames import inverse, transform_points
from ...base.kernels import kernel
from ...rig.optics import picture_rays, project, rays
from ...rig.pair import Rig
from ...rig.pattern import AXES, Code

GRID = 9  # Displacements are exact at this many rows, columns and depths, and are interpolated.


def _depth_m(rig: Rig, near):
    """Return the depth for a nearness of 0, the far end of the range, to 1, the near end."""
    return 1 / (1 / rig.far_m + near * (1 / rig.near_m - 1 / rig.far_m))


def nearnesses(rig: Rig, *, step_px: float) -> Float[np.ndarray, " depths"]:
    """Return nearnesses between which the projector's place moves by at most a step."""
    ray = picture_rays(rig.camera)[::16, ::16]
    far, near = (places(rig, ray, end) for end in (0.0, 1.0))
    return np.linspace(0, 1, math.ceil(float(np.nanmax(np.abs(far - near))) / step_px) + 1)


def places(rig: Rig, ray, near) -> Float[np.ndarray, "2 h w"]:
    """Return the projector's column and row that light each pixel at a depth."""
    point_m = ray * np.asarray(_depth_m(rig, near))[..., None]
    at = project(rig.projector, transform_points(inverse(rig.T_cam_proj), point_m))
    return np.ascontiguousarray(np.moveaxis(at, -1, 0), dtype=np.float32)


def displacements(rig: Rig, T_then_now) -> Float[np.ndarray, "n depths grid grid 4"]:
    """Return each picture's motion of a pixel (x, y) and of a place (column, row)."""
    camera = rig.camera
    x, y = (np.linspace(0, size - 1, GRID) for size in (camera.width_px, camera.height_px))
    pixel = np.stack(np.meshgrid(x, y), axis=-1)
    ray = rays(camera, pixel)
    T_proj_cam = inverse(rig.T_cam_proj)
    shift = np.empty((len(T_then_now), GRID, GRID, GRID, 4), dtype=np.float32)
    for number, near in enumerate(np.linspace(0, 1, GRID)):
        point_m = ray / ray[..., 2:] * _depth_m(rig, near)
        before = project(rig.projector, transform_points(T_proj_cam, point_m))
        for k, T in enumerate(T_then_now):
            moved_m = transform_points(T, point_m)
            shift[k, number, ..., :2] = project(camera, moved_m) - pixel
            at = project(rig.projector, transform_points(T_proj_cam, moved_m))
            shift[k, number, ..., 2:] = at - before
    return shift


class LightOfFrames(NamedTuple):
    """The share of white of each frame at each projector pixel, and its axis (2 for none)."""

    share: Float32[np.ndarray, "n length"]
    axis: Int[np.ndarray, " n"]


def light_of_frames(code: Code) -> LightOfFrames:
    """Return the light that each frame of a code sends to each place."""
    level = np.zeros((len(code.frames), max(code.width_px, code.height_px)), dtype=np.float32)
    of_axis = np.full(len(code.frames), 2)
    for k, frame in enumerate(code.frames):
        share = code.share(frame)
        level[k, : len(share)], level[k, len(share) :] = share, share[-1]
        if frame.axis is not None:
            of_axis[k] = AXES.index(frame.axis)
    return LightOfFrames(level, of_axis)


@kernel()
def at_nearness(shift, near):
    """Return the displacements at a nearness, interpolated between the depths of the grid."""
    at = near * np.float32(shift.shape[1] - 1)
    low = min(int(at), shift.shape[1] - 2)
    return shift[:, low] + (at - np.float32(low)) * (shift[:, low + 1] - shift[:, low])


@kernel()
def between(values, low, t, c):
    """Return one displacement between two columns of the grid."""
    return values[low, c] + t * (values[low + 1, c] - values[low, c])


@kernel()
def value_at(picture, x, y):
    """Return a picture's value between its pixels; -1 outside the picture."""
    h, w = picture.shape
    if x < 0 or y < 0 or x > w - 1 or y > h - 1:
        return np.float32(-1)
    x0, y0 = min(int(x), w - 2), min(int(y), h - 2)
    fx, fy = x - np.float32(x0), y - np.float32(y0)
    top, bottom = np.float32(picture[y0, x0]), np.float32(picture[y0 + 1, x0])
    top += fx * (np.float32(picture[y0, x0 + 1]) - top)
    bottom += fx * (np.float32(picture[y0 + 1, x0 + 1]) - bottom)
    return top + fy * (bottom - top)


@kernel()
def share_at(level, u):
    """Return the share of white at a place between projector pixels."""
    u = min(max(u, np.float32(0)), np.float32(len(level) - 1))
    low = min(int(u), len(level) - 2)
    return level[low] + (u - np.float32(low)) * (level[low + 1] - level[low])
