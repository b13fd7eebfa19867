"""What a dataset holds, in figures: from its files alone, one scene in memory at a time."""

from .gather import Statistics, dataset_statistics, tally
from .plots import draw_statistics
from .scene import SceneFigures, scene_figures
from .stored import (
    DatasetFacts,
    ScenePlace,
    StoredInstance,
    StoredScene,
    find_scenes,
    load_scene,
    read_facts,
)
from .table import statistics_json, statistics_table, write_statistics

__all__ = [
    "DatasetFacts",
    "SceneFigures",
    "ScenePlace",
    "Statistics",
    "StoredInstance",
    "StoredScene",
    "dataset_statistics",
    "draw_statistics",
    "find_scenes",
    "load_scene",
    "read_facts",
    "scene_figures",
    "statistics_json",
    "statistics_table",
    "tally",
    "write_statistics",
]
