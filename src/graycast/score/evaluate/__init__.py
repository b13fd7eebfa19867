"""Scores of detections, poses and depth; imports no code that it scores."""

from .depth import DEPTH, evaluate_depth, write_depth
from .judgement_files import EVALUATION, Evaluation, evaluation_json, summary, write_evaluation
from .judging import Judgement, Protocol
from .labels import Labels, labels_of
from .mistakes import AT_HALF, false_alarms
from .pose_errors import mspd, mssd, rotation_translation, vsd
from .pose_files import POSES, evaluate_poses, poses_markdown, write_poses
from .scores import Scores, score
from .shares import mcnemar, wilson
from .task import Task, evaluate

__all__ = [
    "AT_HALF",
    "DEPTH",
    "EVALUATION",
    "POSES",
    "Evaluation",
    "Judgement",
    "Labels",
    "Protocol",
    "Scores",
    "Task",
    "evaluate",
    "evaluate_depth",
    "evaluate_poses",
    "evaluation_json",
    "false_alarms",
    "labels_of",
    "mcnemar",
    "mspd",
    "mssd",
    "poses_markdown",
    "rotation_translation",
    "score",
    "summary",
    "vsd",
    "wilson",
    "write_depth",
    "write_evaluation",
    "write_poses",
]
