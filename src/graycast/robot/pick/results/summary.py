"""Summarize picks: rates with intervals, outcomes, times, paired comparisons, and plots."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.axes import Axes

from ....base.errors import GraycastError
from ....base.plotting import ACCENT, INK, SOFT, caption, plain_figure, save_png
from ....score.evaluate import mcnemar, wilson
from ..outcome import BEFORE_MOVING, TAKEN, Outcome
from .pick_files import StoredEpisode

_MOVED = [str(outcome) for outcome in Outcome if outcome not in BEFORE_MOVING]
_TAKEN = [str(outcome) for outcome in TAKEN]


@dataclass(frozen=True, slots=True, kw_only=True)
class PickSummary:
    """Summary of all bins of a folder.

    Attributes:
        bins: number of bins.
        grips: number of attempts in which the arm moved to a part.
        picked: number of these attempts that took the part out of the bin.
        rate: `picked` divided by `grips`, with its 95 % interval (Wilson).
        outcomes: number of attempts for each outcome, most frequent first.
        missing: number of attempts that found nothing, for each detail of this outcome.
        cleared: number of bins that were empty at the end.
        filled, taken, left, spilled: numbers of parts, summed over all bins.
        seconds: simulated times of all attempts: `scan`, `motion`.
        work_s: median computing time of an attempt on this machine, by stage.
    """

    bins: int
    grips: int
    picked: int
    rate: tuple[float, float, float]
    outcomes: dict[str, int]
    missing: dict[str, int]
    cleared: int
    filled: int
    taken: int
    left: int
    spilled: int
    seconds: dict[str, float]
    work_s: dict[str, float]

    @property
    def thinking_s(self) -> float:
        """Sum of the median computing times of detection, grips and planning for an attempt."""
        return sum(self.work_s.get(stage, 0.0) for stage in ("detect", "grips", "plan"))

    @property
    def picks_per_hour(self) -> float:
        """Picks per hour if computing took no time."""
        return self._per_hour(0.0)

    @property
    def picks_per_hour_here(self) -> float:
        """Picks per hour, including the median computing time of an attempt on this machine."""
        return self._per_hour(self.thinking_s)

    def _per_hour(self, computing_s: float) -> float:
        total_s = sum(self.seconds.values()) + sum(self.outcomes.values()) * computing_s
        return 3600 * self.picked / total_s if total_s else 0.0


def summarize(episodes: Sequence[StoredEpisode]) -> PickSummary:
    """Return the summary of all bins; raise GraycastError if no bin is finished."""
    if not episodes:
        raise GraycastError("no bin is finished yet: run graycast robot pick first")
    attempts = [attempt for episode in episodes for attempt in episode.attempts]
    work = [stages for episode in episodes for stages in episode.work_s]
    outcomes = Counter(attempt["outcome"] for attempt in attempts)
    missing = Counter(
        attempt.get("detail", "")
        for attempt in attempts
        if attempt["outcome"] == Outcome.NOTHING_FOUND
    )
    grips = sum(outcomes[name] for name in _MOVED)
    picked = sum(outcomes[name] for name in _TAKEN)
    low, high = wilson(picked, grips) if grips else (0.0, 1.0)
    stages = dict.fromkeys(stage for one in work for stage in one)
    return PickSummary(
        bins=len(episodes),
        grips=grips,
        picked=picked,
        rate=(picked / grips if grips else 0.0, low, high),
        outcomes=dict(outcomes.most_common()),
        missing={detail: count for detail, count in missing.most_common() if detail},
        cleared=sum(episode.left == 0 for episode in episodes),
        filled=sum(episode.filled for episode in episodes),
        taken=sum(episode.taken for episode in episodes),
        left=sum(episode.left for episode in episodes),
        spilled=sum(episode.spilled for episode in episodes),
        seconds={
            name: sum(attempt["seconds"][name] for attempt in attempts)
            for name in ("scan", "motion")
        },
        work_s={stage: median(one.get(stage, 0.0) for one in work) for stage in stages},
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """Comparison of two runs over the same bins; attempts are paired in their order.

    The first attempts in a bin have the same heap. Later heaps are similar, but they depend on what
    each run has taken. A pair is two attempts in which the arm moved; `p` is McNemar's p-value.
    """

    pairs: int
    both: int
    only_first: int
    only_second: int

    @property
    def p(self) -> float:
        return mcnemar(self.only_first, self.only_second)


def pair(first: Sequence[StoredEpisode], second: Sequence[StoredEpisode]) -> Paired:
    """Compare two runs; raise GraycastError if no bin has grips in both runs."""
    others = {episode.bin_id: episode for episode in second}
    counts: Counter[tuple[bool, bool]] = Counter()
    for episode in first:
        if episode.bin_id in others:
            grips, other = _grips(episode), _grips(others[episode.bin_id])
            counts.update(zip(grips, other, strict=False))
    if not counts:
        raise GraycastError("the two folders have no common bin in which both robots tried a grip")
    return Paired(
        pairs=sum(counts.values()),
        both=counts[True, True],
        only_first=counts[True, False],
        only_second=counts[False, True],
    )


def _grips(episode: StoredEpisode) -> list[bool]:
    return [
        attempt["outcome"] in _TAKEN for attempt in episode.attempts if attempt["outcome"] in _MOVED
    ]


def compared(runs: Mapping[str, Sequence[StoredEpisode]]) -> str:
    """Return a Markdown table of runs over the same bins; each run is paired with the first.

    Raises:
        GraycastError: a run has no finished bin, or no bin in common with the first run.
    """
    lines = [
        "| run | grips | success | 95 % | parts taken | cleared | picks an hour | with computing "
        "| pairs | only here | only first | p |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    first = next(iter(runs.values()))
    for name, episodes in runs.items():
        summary = summarize(episodes)
        rate, low, high = summary.rate
        beside = "| | | | |"
        if episodes is not first:
            paired = pair(first, episodes)
            beside = (
                f"| {paired.pairs} | {paired.only_second} | {paired.only_first} | {paired.p:.2g} |"
            )
        lines.append(
            f"| {name} | {summary.grips} | {rate:.1%} | {low:.1%} to {high:.1%} | "
            f"{summary.taken} of {summary.filled} | {summary.cleared} of {summary.bins} | "
            f"{summary.picks_per_hour:.0f} | {summary.picks_per_hour_here:.0f} {beside}"
        )
    return "\n".join(lines)


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
    """Plot success rates, failures and remaining parts of runs to a PNG file, one row per run.

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
