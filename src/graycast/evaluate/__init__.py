"""How good detections are: the judge, which imports nothing of what it judges."""

from .depth_files import DEPTH, evaluate_depth, write_depth
from .judging import Judgement, Protocol, Row, judge
from .labels import Labels, labels_of
from .mistakes import AT_HALF, false_alarms
from .scores import Scores, score
from .task import Task, evaluate
from .writing import EVALUATION, Evaluation, evaluation_json, summary, write_evaluation

__all__ = [
    "AT_HALF",
    "DEPTH",
    "EVALUATION",
    "Evaluation",
    "Judgement",
    "Labels",
    "Protocol",
    "Row",
    "Scores",
    "Task",
    "evaluate",
    "evaluate_depth",
    "evaluation_json",
    "false_alarms",
    "judge",
    "labels_of",
    "score",
    "summary",
    "write_depth",
    "write_evaluation",
]
