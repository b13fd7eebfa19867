"""Motion during a scan: belt, rig in a robot's hand, and moving parts; the times of pictures.

A rigid motion of bin and parts relative to the rig is a motion of the rig, so the scene is built
once and is rendered from several poses. Only parts that move on their own need a new scene.

Leaves out: lamps, environment and table keep their places relative to the bin, also if a belt moves
it below them.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation, Slerp

from ..base.errors import ConfigError
from ..base.frames import inverse, rigid, transform_points
from ..base.settings import Positive, Settings
from ..camera.exposure import ExposureTimes
from ..rig.optics import project, rays
from ..rig.pair import Rig
from .views import refuse_no_pose

Pose = Float[np.ndarray, "4 4"]
READOUT_S = 0.010  # Read-out of a picture, as in `VirtualScanner` and in robot cells.
SPEED_STEPS = 32  # Parts of a scan in which the speed of the picture is measured.

_Speed = Annotated[float, Field(ge=-10, le=10)]
_Turn = Annotated[float, Field(ge=-720, le=720)]


class Waypoint(Settings):
    """A pose of the camera at one time."""

    time_s: float = Field(description="The time in seconds after the picture of the ground truth.")
    T_base_cam: tuple[float, ...] = Field(
        description="The camera's pose in a fixed frame such as the robot's base: the 16 numbers "
        "of a 4x4 matrix by rows, in metres.",
    )

    @model_validator(mode="after")
    def _rigid(self) -> "Waypoint":
        refuse_no_pose(self.T_base_cam, "T_base_cam")
        return self


class PartMotion(Settings):
    """A part that moves on its own in the bin's frame, such as one that rolls or swings."""

    part: int = Field(ge=0, description="The number of the part in the scene, counted from 0.")
    velocity_m_s: tuple[_Speed, _Speed, _Speed] = Field(
        default=(0.0, 0.0, 0.0), description="The velocity of the pivot, in metres per second."
    )
    turn_deg_s: tuple[_Turn, _Turn, _Turn] = Field(
        default=(0.0, 0.0, 0.0),
        description="The angular velocity about the axes of the world, in degrees per second.",
    )
    pivot_m: tuple[float, float, float] | None = Field(
        default=None,
        description="A point in the world about which the part turns, at the time of the ground "
        "truth. Without this key, it is the origin of the part's model.",
    )


class MotionSection(Settings):
    """Motion during a scan. The ground truth has the poses in the middle of one picture.

    Each image of a scene is a scan of its own, and nothing moves between two scans.
    """

    belt_m_s: tuple[_Speed, _Speed, _Speed] = Field(
        default=(0.0, 0.0, 0.0),
        description="The velocity of the bin and its parts in the world, in metres per second.",
    )
    rig_m_s: tuple[_Speed, _Speed, _Speed] = Field(
        default=(0.0, 0.0, 0.0),
        description="The velocity of the rig in the world, in metres per second.",
    )
    rig_deg_s: tuple[_Turn, _Turn, _Turn] = Field(
        default=(0.0, 0.0, 0.0),
        description="The angular velocity of the rig about the axes of its camera, in degrees per "
        "second.",
    )
    path: tuple[Waypoint, ...] | None = Field(
        default=None,
        min_length=2,
        description="Poses of the camera with their times, which replace rig_m_s and rig_deg_s. "
        "Only the differences of the poses count: at time 0 the camera has the pose of view.",
    )
    parts: tuple[PartMotion, ...] = Field(
        default=(), description="Parts that move on their own, relative to the bin."
    )
    picture_s: Positive | None = Field(
        default=None,
        description="The time from the start of a picture to the start of the next one, in "
        "seconds. Without this key, it is the exposure plus 10 ms for the read-out.",
    )
    truth_picture: int | None = Field(
        default=None,
        ge=0,
        description="The picture, counted from 0 over all exposures, in the middle of which the "
        "parts have the poses of the ground truth. Without this key, it is the middle picture.",
    )
    compensate: bool = Field(
        default=False,
        description="Whether the decoder knows the motion and takes the pictures back to the time "
        "of the ground truth. It takes seconds to minutes for each exposure of a scan.",
    )
    flow: bool = Field(
        default=False,
        # A dataset without flow has the same files as those of versions without this key.
        exclude_if=lambda flow: not flow,
        description="Whether a dataset has the flow from the ground truth to each picture.",
    )
    render_px: Positive = Field(
        default=0.25,
        description="The largest motion of the picture between two renders, in pixels of the "
        "camera or the projector. Pictures in between are interpolated.",
    )

    @model_validator(mode="after")
    def _one_motion_of_the_rig(self) -> "MotionSection":
        if self.path is None:
            return self
        if any(self.rig_m_s) or any(self.rig_deg_s):
            raise ValueError(
                "path and rig_m_s or rig_deg_s both move the rig: remove path, or the velocities"
            )
        times_s = [waypoint.time_s for waypoint in self.path]
        for before, after in pairwise(times_s):
            if after <= before:
                raise ValueError(
                    f"path has the time {after:g} s after {before:g} s: sort its poses by time"
                )
        if not times_s[0] <= 0 <= times_s[-1]:
            raise ValueError(
                f"path has times from {times_s[0]:g} to {times_s[-1]:g} s: they must include 0, "
                "the time of the ground truth"
            )
        return self


OptionalMotion = Annotated[
    MotionSection | None,
    Field(
        # A dataset without motion has the same files as those of versions without this key.
        exclude_if=lambda motion: motion is None,
        description="Motion of the bin or of the rig while the pictures are taken. Without this "
        "key, nothing moves.",
    ),
]


def pose_at(T_world_cam: Pose, motion: MotionSection, time_s: float) -> Pose:
    """Return the pose of the camera relative to bin and parts at a time after the ground truth.

    Args:
        T_world_cam: the pose at the time of the ground truth.

    Raises:
        ConfigError: the path does not include this time.
    """
    if motion.path is None:
        turn = Rotation.from_rotvec(np.radians(motion.rig_deg_s) * time_s).as_matrix()
        moved = rigid(T_world_cam[:3, :3] @ turn, T_world_cam[:3, 3])
        velocity_m_s = np.subtract(motion.rig_m_s, motion.belt_m_s)
    else:
        moved = T_world_cam @ inverse(_on_path(motion.path, 0.0)) @ _on_path(motion.path, time_s)
        velocity_m_s = -np.array(motion.belt_m_s)
    return rigid(moved[:3, :3], moved[:3, 3] + velocity_m_s * time_s)


def _on_path(path: tuple[Waypoint, ...], time_s: float) -> Pose:
    when_s = [waypoint.time_s for waypoint in path]
    if not when_s[0] <= time_s <= when_s[-1]:
        raise ConfigError(
            f"motion.path has poses from {when_s[0]:g} to {when_s[-1]:g} s, and the scan needs one "
            f"at {time_s:.3g} s: add poses before or after"
        )
    T = np.reshape([waypoint.T_base_cam for waypoint in path], (-1, 4, 4))
    turned = Slerp(when_s, Rotation.from_matrix(T[:, :3, :3]))(time_s).as_matrix()
    return rigid(turned, np.array([np.interp(time_s, when_s, T[:, k, 3]) for k in range(3)]))


def speed_px_s(
    rig: Rig, T_world_cam: Pose, motion: MotionSection, *, start_s: float, end_s: float
) -> float:
    """Return the greatest speed of the picture between two times [px/s].

    It is the greatest speed, in the pictures of camera and projector, of points in the middle, on
    the edges and in the corners of the camera's picture at both ends of the rig's range.
    """
    if end_s <= start_s:
        return 0.0
    camera = rig.camera
    x, y = (np.linspace(0, size - 1, 3) for size in (camera.width_px, camera.height_px))
    pixel = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    ahead = rays(camera, pixel)
    ahead = ahead / ahead[:, 2:]
    point_m = transform_points(T_world_cam, np.vstack([ahead * rig.near_m, ahead * rig.far_m]))
    times_s = np.linspace(start_s, end_s, SPEED_STEPS + 1)
    picture_px = []
    for time_s in times_s:
        T_cam_world = inverse(pose_at(T_world_cam, motion, float(time_s)))
        in_camera_m = transform_points(T_cam_world, point_m)
        in_projector_m = transform_points(inverse(rig.T_cam_proj), in_camera_m)
        picture_px.append([project(camera, in_camera_m), project(rig.projector, in_projector_m)])
    moved_px = np.linalg.norm(np.diff(np.array(picture_px), axis=0), axis=-1)
    return float(np.nanmax(moved_px, initial=0.0) / (times_s[1] - times_s[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Timeline:
    """The times of all pictures of a scan, exposure by exposure, in the order of the code.

    `start_s` is the start of each picture after the time of the ground truth, `duration_s` is its
    exposure. `scan_s` is the time from the first picture until the next scan could start.
    """

    start_s: Float[np.ndarray, "exposures n"]
    duration_s: Float[np.ndarray, " exposures"]
    scan_s: float

    @property
    def middle_s(self) -> Float[np.ndarray, "exposures n"]:
        """The middle of each picture after the time of the ground truth [s]."""
        return self.start_s + self.duration_s[:, None] / 2


def timeline(motion: MotionSection, times: ExposureTimes, frames: int) -> Timeline:
    """Return the times of the pictures of a scan: all frames in the first exposure, then the next.

    Raises:
        ConfigError: `picture_s` is shorter than an exposure, or there is no `truth_picture`.
    """
    duration_s = np.array(times.times_s)
    step_s = duration_s + READOUT_S
    if motion.picture_s is not None:
        if motion.picture_s < duration_s.max():
            raise ConfigError(
                f"motion.picture_s is {motion.picture_s:g} s, and the longest exposure is "
                f"{duration_s.max():.3g} s: give at least the exposure, or shorten it"
            )
        step_s = np.full(len(duration_s), motion.picture_s)
    first_s = np.concatenate([[0.0], np.cumsum(step_s * frames)[:-1]])
    start_s = first_s[:, None] + step_s[:, None] * np.arange(frames)
    count = start_s.size
    picture = count // 2 if motion.truth_picture is None else motion.truth_picture
    if picture >= count:
        raise ConfigError(
            f"motion.truth_picture is {picture}, and the scan has the pictures 0 to {count - 1}: "
            "give one of them"
        )
    middle_s = (start_s + duration_s[:, None] / 2).ravel()[picture]
    scan_s = float(step_s.sum() * frames)
    return Timeline(start_s=start_s - middle_s, duration_s=duration_s, scan_s=scan_s)
