"""Statistics of a dataset, from its files alone, with one scene in memory at a time."""

from .gather import Statistics, dataset_statistics, tally
from .scene_statistics import SceneFigures, scene_figures
from .stats_plots import draw_statistics
from .stats_table import statistics_json, statistics_table, write_statistics

__all__ = [
    "SceneFigures",
    "Statistics",
    "dataset_statistics",
    "draw_statistics",
    "scene_figures",
    "statistics_json",
    "statistics_table",
    "tally",
    "write_statistics",
]
