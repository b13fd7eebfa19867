"""Rasterised depth of an empty bin, with noise and gaps; the fit does not use the rasteriser."""

import numpy as np

from graycast.base.frames import axis_rotation, inverse, look_at, rigid, transform_points
from graycast.real.fit_bin.bin_views import BinView
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics
from graycast.world.scene import Bin, bin_mesh

CAMERA = Optics(width_px=160, height_px=120, fx_px=176.0, fy_px=176.0, cx_px=79.5, cy_px=59.5)
BOX = Bin(inner_m=(0.40, 0.30, 0.15), wall_m=0.012)
_TABLE_M = 0.8  # half of the edge length, so that no corner is behind the camera


def pose(tilt_deg=12.0, azimuth_deg=8.0, roll_deg=3.0, distance_m=0.9, aside_m=(0.02, -0.03)):
    """Return `T_world_cam` of a camera above the bin; its x axis has about this azimuth."""
    turn = axis_rotation("z", np.radians(azimuth_deg))
    tilt = np.radians(tilt_deg)
    away = turn @ np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    down = turn @ np.array([0.0, -np.cos(tilt), -np.sin(tilt)])
    target = np.array([*aside_m, 0.05])
    T = look_at(target + distance_m * away, target, down)
    return T @ rigid(axis_rotation("z", np.radians(roll_deg)), np.zeros(3))


def perfect_depth(T_world_cam, box=BOX, camera=CAMERA, blocks=()):
    """Return z-depth of bin, table and blocks (low and high corners); NaN without a surface."""
    meshes = [(bin_mesh(box).vertices_m, bin_mesh(box).faces), _table(box.wall_m)]
    meshes += [_block(np.array(low), np.array(high)) for low, high in blocks]
    depth = np.full((camera.height_px, camera.width_px), np.inf)
    for vertices, faces in meshes:
        raster = rasterize(transform_points(inverse(T_world_cam), vertices), faces, camera)
        y, x = np.nonzero(np.isfinite(raster.z))
        row, column = y + raster.top_px, x + raster.left_px
        inside = (row >= 0) & (row < camera.height_px) & (column >= 0) & (column < camera.width_px)
        row, column, z = row[inside], column[inside], raster.z[y[inside], x[inside]]
        depth[row, column] = np.minimum(depth[row, column], z)
    return np.where(np.isinf(depth), np.nan, depth)


def noisy(depth_m, sigma_m, seed):
    return depth_m + sigma_m * np.random.default_rng(seed).standard_normal(depth_m.shape)


def view(depth_m, camera=CAMERA, rgb=None, name="made"):
    return BinView(name=name, camera=camera, depth_m=depth_m, rgb=rgb)


def world_points(depth_m, T_world_cam, camera=CAMERA):
    """Return the point at each pixel in the frame of the bin."""
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    ray = np.stack([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px], -1)
    point = np.concatenate([ray, np.ones_like(ray[..., :1])], -1) * depth_m[..., None]
    return transform_points(T_world_cam, point)


def without(depth_m, T_world_cam, hidden, box=BOX, camera=CAMERA):
    """Remove the depth of points for which `hidden` is true; it takes points in the bin's frame."""
    point = world_points(depth_m, T_world_cam, camera)
    return np.where(hidden(point), np.nan, depth_m)


def _table(wall_m):
    x = _TABLE_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.column_stack([x, np.full(4, -wall_m)]), np.array([[0, 1, 2], [0, 2, 3]])


def _block(low, high):
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return low + corner * (high - low), faces
