"""Pose estimation of a part from a detection and the scanner's depth."""

from .finding import PoseMatch, find_pose, find_pose_in_box, find_poses
from .model import PoseModel, pose_model

__all__ = [
    "PoseMatch",
    "PoseModel",
    "find_pose",
    "find_pose_in_box",
    "find_poses",
    "pose_model",
]
