"""A simulated robot that empties a bin, from the rendered scan to the lifted part.

pick_sections, robot_cell, ready, arms, robot   the robot's cell: settings, files and preparation
tools, suction_tool, jaw_tool, contact          grippers: the protocol, its two kinds, and contact
bin_scan, aim, choose      a scan, the grips on the scanned parts, and the choice of a grip
obstacles, motion, ways    collision-free paths of the arm
touch, carry, episode      execution of the grip, and the sequence of picks from one bin
outcome, pick_files, pick_run, clock            results, their folder, and runs over many bins
summary, replay, solids    summaries of the results, and data for their animation
"""

from .outcome import Attempt, Outcome
from .pick_files import StoredEpisode, read_episodes
from .pick_run import pick
from .pick_sections import PickConfig, load_pick_config
from .robot_cell import PickCell, resolve_pick_cell
from .summary import Paired, PickSummary, compared, pair, plot_runs, summarize

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
