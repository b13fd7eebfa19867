"""Grasp labels of a dataset: where a tool would hold each part, and whether it does in physics."""

from .options import Labelling, read_tool
from .ranking import Ranking, rank
from .running import label_dataset

__all__ = ["Labelling", "Ranking", "label_dataset", "rank", "read_tool"]
