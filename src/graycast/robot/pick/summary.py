"""A summary of picks: rates with intervals, outcomes and times, and paired comparisons."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from ...base.errors import GraycastError
from ...score.evaluate import mcnemar, wilson
from .outcome import BEFORE_MOVING, TAKEN, Outcome
from .pick_files import StoredEpisode

_MOVED = [str(outcome) for outcome in Outcome if outcome not in BEFORE_MOVING]
_TAKEN = [str(outcome) for outcome in TAKEN]


@dataclass(frozen=True, slots=True, kw_only=True)
class PickSummary:
    """Of all bins of a folder.

    Attributes:
        bins: how many.
        grips: attempts in which the arm went for a part.
        picked: of these, those that took it out of the bin.
        rate: `picked` over `grips`, with its 95 % interval (Wilson).
        outcomes: all attempts by how they ended, most frequent first.
        missing: attempts that found nothing, by what was not found.
        cleared: bins that ended with nothing in them.
        filled, taken, left, spilled: parts of all bins.
        seconds: simulated, of all attempts: `scan`, `motion`.
        work_s: median of this machine's seconds of an attempt, by stage.
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
        """This machine's median of detection, grips and plan for one attempt."""
        return sum(self.work_s.get(stage, 0.0) for stage in ("detect", "grips", "plan"))

    @property
    def picks_per_hour(self) -> float:
        """Of robot and scanner alone, as if computing took no time."""
        return self._per_hour(0.0)

    @property
    def picks_per_hour_here(self) -> float:
        """With the median time that this machine computes for an attempt."""
        return self._per_hour(self.thinking_s)

    def _per_hour(self, computing_s: float) -> float:
        total_s = sum(self.seconds.values()) + sum(self.outcomes.values()) * computing_s
        return 3600 * self.picked / total_s if total_s else 0.0


def summarize(episodes: Sequence[StoredEpisode]) -> PickSummary:
    """Raise GraycastError if no bin is finished."""
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
    """Two arms over the same bins: attempt by attempt in the order in which they were made.

    The first attempts of a bin are of one heap; later ones are of what each arm left, so that they
    are alike and not equal. `p` is McNemar's, over the pairs in which both arms moved.
    """

    pairs: int
    both: int
    only_first: int
    only_second: int

    @property
    def p(self) -> float:
        return mcnemar(self.only_first, self.only_second)


def pair(first: Sequence[StoredEpisode], second: Sequence[StoredEpisode]) -> Paired:
    """Raise GraycastError if the two have no common bin."""
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
    """Runs over the same bins as a Markdown table; each is paired with the first.

    Raises:
        GraycastError: one has no bin, or no common bin with the first.
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
