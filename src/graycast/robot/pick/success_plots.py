"""Runs beside one another as a picture: rates of success, failures by outcome, what is left."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ...base.plotting import ACCENT, INK, SOFT, caption, plain_figure, save_png
from .outcome import Outcome
from .summary import PickSummary

COLOR = {
    Outcome.NOTHING_FOUND: "#c3ccd5",
    Outcome.COLLISION_SEEN: "#9aa5b1",
    Outcome.UNREACHABLE: "#6b7785",
    Outcome.GIVEN_UP: "#434e5a",
    Outcome.MISSED: "#f2c14e",
    Outcome.WRONG_POSE: "#e0a458",
    Outcome.NOT_HELD: "#c4622d",
    Outcome.COLLISION_UNSEEN: "#8f2d56",
    Outcome.LOST_SEAL: "#3c91a0",
    Outcome.SLIPPED: "#1f4e79",
}


def plot_runs(runs: Mapping[str, PickSummary], path: Path) -> None:
    """Write a PNG with a row for each run, the first on top.

    Raises:
        GraycastError: the file cannot be written.
    """
    figure, (rate, failures, left) = plain_figure(
        11.0, 1.7 + 0.32 * len(runs), (1.0, 1.6, 0.7), grid="x"
    )
    _rates(rate, runs)
    _failures(failures, runs)
    share = [100 * picks.left / picks.filled if picks.filled else 0.0 for picks in runs.values()]
    left.barh(range(len(runs)), share, color=SOFT, height=0.6)
    caption(left, "Parts left in the bins", "of 100 parts")
    for ax in (rate, failures, left):
        ax.set_yticks(range(len(runs)), list(runs) if ax is rate else [])
        ax.set_ylim(len(runs) - 0.4, -0.6)
    figure.legend(fontsize=8, frameon=False, ncols=6, loc="outside lower center")
    save_png(figure, path, dpi=110)


def _rates(ax: Axes, runs: Mapping[str, PickSummary]) -> None:
    rate, low, high = 100 * np.array([picks.rate for picks in runs.values()]).T
    ends = np.stack([rate - low, high - rate])
    ax.errorbar(rate, range(len(runs)), xerr=ends, fmt="o", color=ACCENT, ecolor=INK, lw=1.2, ms=5)
    ax.set_xlim(right=100.5)
    caption(ax, "Grips that took a part out", "%, with the 95 % interval")


def _failures(ax: Axes, runs: Mapping[str, PickSummary]) -> None:
    start = np.zeros(len(runs))
    parts = np.array([max(picks.filled, 1) for picks in runs.values()])
    for outcome, color in COLOR.items():
        count = np.array([picks.outcomes.get(str(outcome), 0) for picks in runs.values()])
        if count.any():
            each = 100 * count / parts
            ax.barh(range(len(runs)), each, left=start, color=color, height=0.6, label=outcome)
            start += each
    caption(ax, "Attempts that took none, by outcome", "for 100 parts in the bins")
