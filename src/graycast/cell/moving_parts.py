"""Parts that move on their own during a scan, and the flow of all points.

Leaves out: contact. Nothing checks whether a part that moves meets another one.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError
from ..base.frames import inverse, pixel_grid, rigid, transform_points
from ..rendering import GroundTruth
from ..rig.optics import points, project
from ..rig.pair import Rig
from ..world.scene import Layout, Scene
from .motion import MotionSection, PartMotion, Pose, pose_at


def layout_at(layout: Layout, motion: MotionSection, time_s: float) -> Layout:
    """Return the poses of all parts relative to the bin at a time after the ground truth.

    Raises:
        ConfigError: there is no part with this number.
    """
    if not motion.parts:
        return layout
    T_world_part = layout.T_world_part.copy()
    for own in motion.parts:
        if own.part >= len(T_world_part):
            raise ConfigError(
                f"motion.parts has part {own.part}, and the scene has {len(T_world_part)} parts: "
                "give a number that is less"
            )
        T = T_world_part[own.part]
        T_world_part[own.part] = _moved(own, T, time_s) @ T
    return replace(layout, T_world_part=T_world_part)


def _moved(own: PartMotion, T_world_part: Pose, time_s: float) -> Pose:
    """Return the motion of a part in the world since the time of the ground truth."""
    pivot_m = T_world_part[:3, 3] if own.pivot_m is None else np.array(own.pivot_m)
    turn = Rotation.from_rotvec(np.radians(own.turn_deg_s) * time_s).as_matrix()
    return rigid(turn, pivot_m - turn @ pivot_m + np.array(own.velocity_m_s) * time_s)


def parts_speed_px_s(
    scene: Scene, layout: Layout, motion: MotionSection, *, start_s: float, end_s: float
) -> float:
    """Return the greatest speed of moving parts in the pictures of camera and projector [px/s].

    It is that of the corners of their bounding boxes, between 33 times from start to end.

    Raises:
        ConfigError: there is no part with this number; the path does not include a time.
    """
    if end_s <= start_s:
        return 0.0
    times_s = np.linspace(start_s, end_s, 33)
    later = [layout_at(layout, motion, time_s) for time_s in times_s.tolist()]
    cameras = [pose_at(scene.T_world_cam, motion, time_s) for time_s in times_s.tolist()]
    fastest = 0.0
    for own in motion.parts:
        low, high = scene.parts[layout.part_index[own.part]].mesh.bounds_m
        corner_m = np.array(np.meshgrid(*np.stack([low, high], axis=-1))).reshape(3, -1).T
        place_px = [
            _places(
                scene.rig, transform_points(inverse(T) @ moved.T_world_part[own.part], corner_m)
            )
            for T, moved in zip(cameras, later, strict=True)
        ]
        moved_px = np.linalg.norm(np.diff(np.array(place_px), axis=0), axis=-1)
        fastest = max(fastest, float(np.nanmax(moved_px, initial=0.0)) / (times_s[1] - times_s[0]))
    return fastest


def _places(rig: Rig, in_camera_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 n 2"]:
    in_projector_m = transform_points(inverse(rig.T_cam_proj), in_camera_m)
    return np.stack([project(rig.camera, in_camera_m), project(rig.projector, in_projector_m)])


def flow_px(
    scene: Scene, layout: Layout, truth: GroundTruth, motion: MotionSection, time_s: float
) -> Float[np.ndarray, "h w 2"]:
    """Return how far the surface point of each pixel is from this pixel at another time [px].

    The flow is NaN where the perfect depth is NaN.

    Args:
        time_s: the other time after that of the ground truth.

    Raises:
        ConfigError: the path does not include this time; there is no part with this number.
    """
    camera, T_world_cam = scene.rig.camera, scene.T_world_cam
    world_m = transform_points(T_world_cam, points(camera, truth.depth_m))
    later = layout_at(layout, motion, time_s)
    for own in motion.parts:
        on_part = truth.instance == own.part
        T = later.T_world_part[own.part] @ inverse(layout.T_world_part[own.part])
        world_m[on_part] = transform_points(T, world_m[on_part])
    then_m = transform_points(inverse(pose_at(T_world_cam, motion, time_s)), world_m)
    return project(camera, then_m) - pixel_grid(camera.height_px, camera.width_px)
