"""A simulated robot that empties a bin: from light to the lifted part."""

from .outcome import Attempt, Outcome
from .pick_files import StoredEpisode, read_episodes
from .pick_run import pick_bins
from .pick_sections import PickConfig, load_pick_config
from .robot_cell import PickCell, resolve_pick_cell
from .success_plots import plot_runs
from .summary import Paired, PickSummary, compared, pair, summarize

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
    "pick_bins",
    "plot_runs",
    "read_episodes",
    "resolve_pick_cell",
    "summarize",
]
