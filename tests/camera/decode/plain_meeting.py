"""Slow versions of the compiled meeting of rays and planes, in NumPy, for tests to compare with.

OpenCV's own functions remove the distortion and apply it.
"""

import cv2
import numpy as np

from graycast.base.frames import transform_points
from graycast.camera.decode.meeting import DISTORTION_ITERATIONS
from graycast.rig.optics import picture_rays, project


def meet_plain(ray, across, along, rig, i):
    """Return depth and its derivative by the position; `i` is 0 for columns, 1 for rows."""
    projector = rig.projector
    focal = (projector.fx_px, projector.fy_px)
    centre = (projector.cx_px, projector.cy_px)
    size = (projector.width_px, projector.height_px)
    distorted = (across - centre[i]) / focal[i]
    depth_m, slope_m = _depth(ray, distorted, rig.T_proj_cam, i, focal[i])
    if not projector.has_distortion:
        return depth_m, slope_m
    for _ in range(DISTORTION_ITERATIONS):
        expected = project(projector, transform_points(rig.T_proj_cam, ray * depth_m[:, None]))
        guess = np.clip(expected[:, 1 - i], -0.5, size[1 - i] - 0.5)
        other = (np.where(np.isfinite(along), along, guess) - centre[1 - i]) / focal[1 - i]
        xy = np.stack([distorted, other] if i == 0 else [other, distorted], axis=-1)
        known = np.isfinite(xy).all(axis=-1)
        ideal = np.full(len(ray), np.nan)
        ideal[known] = cv2.undistortPoints(
            xy[known][:, None],
            np.eye(3),
            np.array(projector.distortion),
            criteria=(cv2.TERM_CRITERIA_MAX_ITER, 200, 0.0),
        )[:, 0, i]
        depth_m, slope_m = _depth(ray, ideal, rig.T_proj_cam, i, focal[i])
    return depth_m, slope_m


def off_the_line_plain(ray, depth_m, along, rig, i):
    """Return the distance of the position along the planes from its expected value [px]."""
    return along - _opencv_px(rig, ray * depth_m[:, None])[:, 1 - i]


def beside_plain(rig):
    """Whether both ends of a pixel's ray are beyond one side of the projector's picture."""
    ray, end = (
        picture_rays(rig.camera),
        (rig.projector.width_px - 0.5, rig.projector.height_px - 0.5),
    )
    ends = [_opencv_px(rig, (ray * z_m).reshape(-1, 3)) for z_m in (rig.near_m, rig.far_m)]
    sides = [np.concatenate([px < -0.5, px > end], axis=-1) for px in ends]
    return (sides[0] & sides[1]).any(axis=-1).reshape(ray.shape[:2])


def _opencv_px(rig, point_m):
    """Return projector positions of points in the camera frame; NaN outside of the lens model."""
    projector = rig.projector
    point = transform_points(rig.T_proj_cam, point_m)
    known = np.isfinite(project(projector, point)).all(axis=-1)
    px = np.full((len(point), 2), np.nan)
    zero, distortion = np.zeros(3), np.array(projector.distortion)
    px[known] = cv2.projectPoints(point[known], zero, zero, projector.K, distortion)[0][:, 0]
    return px


def _depth(ray, ideal, T_proj_cam, i, focal_px):
    """Return the depth of each ray on the plane of an ideal position, and its derivative."""
    rotation, translation = T_proj_cam[:3, :3], T_proj_cam[:3, 3]
    ahead = ray @ rotation[2]
    facing = ray @ rotation[i] - ideal * ahead
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = (ideal * translation[2] - translation[i]) / facing
        return depth_m, (translation[2] + depth_m * ahead) / facing / focal_px
