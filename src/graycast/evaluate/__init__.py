"""How good detections are: the judge, which imports nothing of what it judges."""

from .labels import Labels, labels_of
from .scores import Scores, score

__all__ = ["Labels", "Scores", "labels_of", "score"]
