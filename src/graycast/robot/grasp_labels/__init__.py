"""Grasp labels of a dataset: grips on each part, and their success in a physics simulation."""

from .label_options import Labelling, read_tool
from .label_run import label_dataset
from .label_success import Ranking, describe_ranking, rank

__all__ = ["Labelling", "Ranking", "describe_ranking", "label_dataset", "rank", "read_tool"]
