"""A simulated robot that empties a bin: from light to the lifted part.

pick_sections, robot_cell, ready, arms, robot   the cell that is written, read, and prepared
tools, suction_tool, jaw_tool, contact          grippers: what is asked of them, and which are
bin_scan, aim, choose      a scan, the grips on it, and the one that is taken
obstacles, motion, ways    paths of the arm
touch, carry, episode      what then happens, pick after pick
outcome, pick_files, pick_run, clock            results, their folder, many bins
summary, replay, solids    results for people
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
