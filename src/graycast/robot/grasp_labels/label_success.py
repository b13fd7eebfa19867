"""Compare the scores of labelled grips with their success in the physics simulation."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...dataset.check.grasp_files import GRASPS
from ...score.evaluate import wilson
from ...score.evaluate.intervals import Interval
from ...score.evaluate.shares import roc_auc_of_scenes
from .label_files import read_scene_labels

BANDS = ((0.0, 0.0), (0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 0.999), (0.999, 1.0))
"""Limits of the bands of scores. A band excludes its first number; the first band is only 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """The number of grips with scores in a band, and the number of them that held in physics."""

    low: float
    high: float
    grips: int
    held: int

    @property
    def rate(self) -> tuple[float, float, float]:
        return self.held / self.grips, *wilson(self.held, self.grips)

    @property
    def contradicted(self) -> bool:
        """Whether the rate's confidence interval and the band are on different sides of 0.5."""
        if not self.grips:
            return False
        _, low, high = self.rate
        return (self.high <= 0.5 < low) or (high < 0.5 <= self.low)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranking:
    """Statistics of a set of labels.

    `auc` covers all simulated grips; `auc_above_0` covers those with a score above 0.
    """

    scenes: int
    labels: int
    reach: Mapping[str, int]
    ended: Mapping[str, int]
    bands: tuple[Band, ...]
    auc: Interval
    auc_above_0: Interval

    @property
    def simulated(self) -> int:
        return sum(self.ended.values())

    @property
    def rate(self) -> tuple[float, float, float]:
        lifted = self.ended.get("held", 0)
        return lifted / self.simulated, *wilson(lifted, self.simulated)


def rank(dataset: Path, name: str) -> Ranking:
    """Read a set of labels and return its statistics.

    Raises:
        DatasetError: a file is damaged.
    """
    files = sorted((dataset / GRASPS / name).glob("*/*.json"))
    reach, ended = Counter[str](), Counter[str]()
    rows = []
    for number, path in enumerate(files):
        for entry in read_scene_labels(path).image:
            for grasp in entry.grasps:
                reach[grasp.reach] += 1
                if grasp.simulated is not None:
                    ended[grasp.simulated.ended] += 1
                    rows.append((grasp.score, grasp.simulated.success, number))
    score = np.array([row[0] for row in rows], dtype=np.float64)
    success = np.array([row[1] for row in rows], dtype=bool)
    scene = np.array([row[2] for row in rows], dtype=np.int64)
    above = score > 0
    return Ranking(
        scenes=len(files),
        labels=reach.total(),
        reach=dict(reach.most_common()),
        ended=dict(ended.most_common()),
        bands=tuple(_band(score, success, *band) for band in BANDS),
        auc=roc_auc_of_scenes(score, success, scene, seed=0),
        auc_above_0=roc_auc_of_scenes(score[above], success[above], scene[above], seed=0),
    )


def _band(score: np.ndarray, success: np.ndarray, low: float, high: float) -> Band:
    inside = (score > low) & (score <= high) if high > 0 else score == 0
    return Band(low=low, high=high, grips=int(inside.sum()), held=int(success[inside].sum()))


def describe_ranking(ranking: Ranking) -> str:
    """Return the success of the labels by score as text, with notes on contradictions."""
    reach = ", ".join(f"{count} {name}" for name, count in ranking.reach.items())
    lines = [f"{ranking.labels} labels in {ranking.scenes} scenes: {reach}"]
    if not ranking.simulated:
        return lines[0]
    ended = ", ".join(f"{count} {name}" for name, count in ranking.ended.items())
    rate, low, high = ranking.rate
    lines.append(
        f"{ranking.simulated} carried out: {rate:.1%} held (95 % interval {low:.1%} to "
        f"{high:.1%}); {ended}"
    )
    for band in ranking.bands:
        if band.grips:
            rate, low, high = band.rate
            lines.append(
                f"  score {_span(band):18} {band.held:4d} of {band.grips:4d} held, {rate:6.1%} "
                f"({low:.1%} to {high:.1%})"
            )
    lines.append(f"the score ranks success with ROC AUC {_interval(ranking.auc)}")
    lines.append(f"  among scores above 0               {_interval(ranking.auc_above_0)}")
    lines += [
        f"note: {band.held} of {band.grips} grips with score {_span(band)} were held: score and "
        "simulation contradict each other here. The simulated results are those of the true "
        "surfaces and poses: use them, and not the score, for this tool and these parts"
        for band in ranking.bands
        if band.contradicted
    ]
    return "\n".join(lines)


def _span(band: Band) -> str:
    return "0" if band.high == 0 else f"above {band.low:g} to {band.high:g}"


def _interval(figure: Interval) -> str:
    if math.isnan(figure.value):
        return "unknown: all were held, or none"
    return f"{figure.value:.3f} (95 % interval {figure.low:.3f} to {figure.high:.3f})"
