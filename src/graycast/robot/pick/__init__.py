"""A simulated robot that empties a bin, from the rendered scan to the lifted part.

outcome  the possible outcomes of an attempt, and its record
arm      the arm of the robot: kinematics, obstacles, and collision-free paths
tool     grippers: the protocol, its two kinds, and contact with the parts
bin      the cell, scans, the choice of a grip, and the sequence of picks from one bin
results  the folder of results, runs over many bins, summaries, and animations
"""

from .bin.pick_sections import PickConfig, load_pick_config
from .bin.robot_cell import PickCell, resolve_pick_cell
from .outcome import Attempt, Outcome
from .results.pick_files import StoredEpisode, read_episodes
from .results.pick_run import pick
from .results.summary import Paired, PickSummary, compared, pair, plot_runs, summarize

__all__ = [
    "Attempt",
    "Outcome",
    "Paired",
    "PickCell",
    "PickConfig",
    "PickSummary",
    "StoredEpisode",
    "compared",
    "load_pick_config",
    "pair",
    "pick",
    "plot_runs",
    "read_episodes",
    "resolve_pick_cell",
    "summarize",
]
