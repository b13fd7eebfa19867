"""A simulated robot that empties a bin: from light to the lifted part."""

from .cell import PickCell, resolve_pick_cell
from .files import StoredEpisode, read_episodes
from .outcome import Attempt, Outcome
from .plots import plot_runs
from .running import pick_bins
from .sections import PickConfig, load_pick_config
from .summary import Paired, Summary, compared, pair, summarize

__all__ = [
    "Attempt",
    "Outcome",
    "Paired",
    "PickCell",
    "PickConfig",
    "StoredEpisode",
    "Summary",
    "compared",
    "load_pick_config",
    "pair",
    "pick_bins",
    "plot_runs",
    "read_episodes",
    "resolve_pick_cell",
    "summarize",
]
