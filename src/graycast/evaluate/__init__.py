"""How good detections are: the judge, which imports nothing of what it judges."""

from .judging import Judgement, Protocol, Row, judge
from .labels import Labels, labels_of
from .scores import Scores, score
from .task import Task, evaluate
from .writing import EVALUATION, Evaluation, evaluation_json, summary, write_evaluation

__all__ = [
    "EVALUATION",
    "Evaluation",
    "Judgement",
    "Labels",
    "Protocol",
    "Row",
    "Scores",
    "Task",
    "evaluate",
    "evaluation_json",
    "judge",
    "labels_of",
    "score",
    "summary",
    "write_evaluation",
]
