"""Confidence intervals of the figures by the bootstrap over scenes.

Parts of one scene share light and clutter, and so do its pictures from several views. Scenes are
therefore resampled, and not parts or pictures. Each draw takes as many scenes as there are, with
repetition; detections are matched once.

Percentiles of such draws are too narrow for few scenes, by the factor sqrt((n - 1) / n) and by
what Student's t is wider than the normal distribution. Both are put right by taking percentiles
farther out: at five scenes nearly the least and the greatest draw.

Average precision is no mean over scenes, so more than half of the draws may lie above the estimate.
With the share p of draws below it and z0 = Phi^-1(p), the limits are the percentiles
Phi(2 z0 - z) and Phi(2 z0 + z) instead of Phi(-z) and Phi(z): the bias-corrected interval, which
contains the estimate. The correction is limited to z / 2, where one limit is the median of the
draws; an estimate that lies beyond all that is itself the other limit.

Sources: Hesterberg, "What Teachers Should Know About the Bootstrap", The American Statistician
69(4), 2015 (section 5.3, expanded percentile interval); Efron, "Nonparametric Standard Errors and
Confidence Intervals", Canadian Journal of Statistics 9(2), 1981 (bias-corrected percentiles).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from ...base.errors import GraycastError
from ...base.public_value import public_value
from .scores import Scores, figures_of_draws

LEVEL = 0.95
DRAWS = 1000
_EQUAL = 1e-12  # Resampled values this near to the estimate differ from it by rounding only.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A figure with its 95 % confidence interval; NaN if the interval is not known."""

    value: float
    low: float
    high: float

    def text(self, form: str = ".3f", *, unit: str = "", none: str = "none") -> str:
        """Return the figure in a format and, in brackets, its limits; `none` where it is NaN."""
        if math.isnan(self.value):
            return none
        text = f"{self.value:{form}}{unit}"
        if math.isnan(self.low):
            return text
        return f"{text} ({self.low:{form}} to {self.high:{form}})"

    def cells(self) -> list[str]:
        """Return value and limits for a spreadsheet, empty where they are not known."""
        numbers = (self.value, self.low, self.high)
        return ["" if math.isnan(x) else f"{x:.6f}" for x in numbers]


def draw_scenes(
    scene_of: Sequence[int], *, seed: int, draws: int = DRAWS
) -> Int[np.ndarray, "draws pictures"]:
    """Return how often each draw contains each picture's scene.

    Draws are equal for results of equally many scenes. `scene_of` is the scene of each picture.
    """
    ids, place = np.unique(np.asarray(scene_of), return_inverse=True)
    even = np.full(len(ids), 1 / len(ids))
    return np.random.default_rng(seed).multinomial(len(ids), even, size=draws)[:, place]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BootstrapFigure:
    """A figure with its value in each draw, so that sums of figures also get intervals.

    Figures of the same scenes from the same seed are paired: their difference has the interval of
    the paired difference. Figures of different sets of scenes come from different seeds.
    """

    value: float
    draws: Float[np.ndarray, " draws"]
    scenes: int

    def __post_init__(self) -> None:
        self.draws.flags.writeable = False

    def __sub__(self, other: "BootstrapFigure") -> "BootstrapFigure":
        return BootstrapFigure(
            value=self.value - other.value,
            draws=self.draws - other.draws,
            scenes=min(self.scenes, other.scenes),
        )

    @property
    def interval(self) -> Interval:
        return interval_of(self.value, self.draws, self.scenes)


def figures_with_draws(
    scores: Scores, times: Int[np.ndarray, "draws pictures"]
) -> dict[str, BootstrapFigure]:
    """Return `FIGURES` of the scores, each with its draws."""
    return {
        name: BootstrapFigure(value=getattr(scores, name), draws=draws, scenes=scores.scenes)
        for name, draws in figures_of_draws(scores.matches, times).items()
    }


def with_intervals(scores: Scores, times: Int[np.ndarray, "draws pictures"]) -> dict[str, Interval]:
    """Return `FIGURES` of the scores, each with its interval."""
    return {name: figure.interval for name, figure in figures_with_draws(scores, times).items()}


def differences(
    scores: Scores, other: Scores, times: Int[np.ndarray, "draws pictures"]
) -> dict[str, Interval]:
    """Return `FIGURES` of the scores minus the other's, with the same scenes in every draw.

    Raises:
        GraycastError: they are of different scenes.
    """
    if scores.scene_ids != other.scene_ids:
        raise GraycastError(
            f"results of {len(scores.scene_ids)} scenes cannot be compared with results of "
            f"{len(other.scene_ids)} other scenes: give results of the same scenes"
        )
    mine, its = (figures_with_draws(one, times) for one in (scores, other))
    return {name: (mine[name] - its[name]).interval for name in mine}


def bootstrap(scores: Scores, figure: str, *, seed: int) -> BootstrapFigure:
    """Return one of `FIGURES` of the scores, with its draws."""
    return figures_with_draws(scores, draw_scenes(scores.scene_of, seed=seed))[figure]


def mean(figures: Sequence[BootstrapFigure]) -> BootstrapFigure:
    """Return the mean of figures of different sets of scenes."""
    return BootstrapFigure(
        value=float(np.mean([each.value for each in figures])),
        draws=np.mean([each.draws for each in figures], axis=0),
        scenes=min(each.scenes for each in figures),
    )


def interval_of(value: float, draws: Float[np.ndarray, " draws"], scenes: int) -> Interval:
    """Return the interval of a figure from its draws; it always contains the figure.

    Draws that have nothing to find are NaN; they tell nothing and are left out.
    """
    draws = draws[~np.isnan(draws)]
    if scenes < 2 or not len(draws):
        return Interval(value=value, low=float("nan"), high=float("nan"))
    z = np.sqrt(scenes / (scenes - 1)) * stats.t.ppf((1 + LEVEL) / 2, scenes - 1)
    below, above = np.mean(draws < value - _EQUAL), np.mean(draws > value + _EQUAL)
    bias = np.clip(
        stats.norm.ppf((1 + below - above) / 2), -z / 2, z / 2
    )  # Equal values count half.
    low, high = np.quantile(draws, stats.norm.cdf([2 * bias - z, 2 * bias + z]))
    return Interval(value=value, low=min(float(low), value), high=max(float(high), value))
