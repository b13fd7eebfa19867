"""Values of a stored image as arrays, for the exports of what a camera would publish."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16

from ...base.frames import inverse
from ...rig.pattern import CodeSpec
from ..read.example import pose_m
from ..read.scene_content import label_map
from ..read.stored import StoredScene


def camera_pose(scene: StoredScene) -> Float[np.ndarray, "4 4"] | None:
    """Return T_world_cam [m] of the optical frame; None for real pictures."""
    if scene.real:
        return None
    view = scene.view()
    return inverse(pose_m(view.cam_R_w2c, view.cam_t_w2c))


def part_poses(scene: StoredScene) -> Float[np.ndarray, "n 4 4"]:
    """Return T_cam_part [m] of every instance, visible or hidden, of a simulated scene."""
    poses = [pose_m(pose.cam_R_m2c, pose.cam_t_m2c) for pose in scene.poses()]
    return np.stack(poses) if poses else np.empty((0, 4, 4))


def instance_numbers(scene: StoredScene) -> UInt16[np.ndarray, "h w"]:
    """Return k + 1 where instance k of `scene_gt.json` is visible, and 0 elsewhere."""
    return (label_map(scene.instances(), scene.size_px) + 1).astype(np.uint16)


def exposure_times(scene: StoredScene, taker: Mapping[str, Any]) -> Float[np.ndarray, " n"] | None:
    """Return the exposure time [s] of each picture of the stack; None if it is unknown.

    Args:
        taker: the scanner's rig and settings.
    """
    manifest = scene.manifest()
    code = taker.get("scanner", {}).get("code")
    if code is None or "exposure_s" not in manifest:
        return None  # Real pictures state neither.
    factors, times_s = taker["scanner"]["exposure"]["factors"], [manifest["exposure_s"]]
    if len(factors) > 1:
        times_s = [factor * manifest["exposure_s"] for factor in factors]
    frames = code.get("frames")  # Only a code of the user's own lists them.
    if frames is None:
        projector = taker["rig"]["projector"]
        spec = CodeSpec(**code | {"axes": tuple(code["axes"])})
        frames = spec.code(projector["width_px"], projector["height_px"]).frames
    return np.tile(manifest.get("exposures_s", times_s), len(frames))
