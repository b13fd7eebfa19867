"""Pose estimation of a part from a detection and the scanner's depth."""

from .finding import PoseFound, find_pose, find_pose_in_box, find_poses
from .model import PoseModel, pose_model

__all__ = [
    "PoseFound",
    "PoseModel",
    "find_pose",
    "find_pose_in_box",
    "find_poses",
    "pose_model",
]
