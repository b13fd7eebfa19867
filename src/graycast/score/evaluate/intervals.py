"""Confidence intervals of the figures, from a bootstrap over scenes.

The parts of a scene share light and clutter, and so do its pictures from several views. Therefore
whole scenes are resampled, not parts or pictures. Each draw takes n of the n scenes with
replacement; detections are matched only once.

For few scenes, percentiles of such draws are too narrow: by the factor sqrt((n - 1) / n), and
because Student's t distribution is wider than the normal distribution. Percentiles farther out
correct both errors; for five scenes they are nearly the smallest and the largest draw.

Average precision is not a mean over scenes, so more than half of the draws may exceed the estimate.
With the share p of draws below the estimate and z0 = Phi^-1(p), the limits are the percentiles
Phi(2 z0 - z) and Phi(2 z0 + z) instead of Phi(-z) and Phi(z) (a bias-corrected interval). The
correction z0 is limited to +-z / 2; at this limit, the median of the draws is one end of the
interval. If the estimate is still outside the interval, the interval is extended to it.

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
_EQUAL = 1e-12  # tolerance for rounding errors of resampled values that equal the estimate


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A figure with its 95 % confidence interval; the limits are NaN if unknown."""

    value: float
    low: float
    high: float

    def text(self, form: str = ".3f", *, unit: str = "", none: str = "none") -> str:
        """Return the formatted figure with its limits in brackets; `none` if the figure is NaN."""
        if math.isnan(self.value):
            return none
        text = f"{self.value:{form}}{unit}"
        if math.isnan(self.low):
            return text
        return f"{text} ({self.low:{form}} to {self.high:{form}})"

    def cells(self) -> list[str]:
        """Return the value and its limits as cells of a spreadsheet; NaN becomes an empty cell."""
        numbers = (self.value, self.low, self.high)
        return ["" if math.isnan(x) else f"{x:.6f}" for x in numbers]


def draw_scenes(
    scene_of: Sequence[int], *, seed: int, draws: int = DRAWS
) -> Int[np.ndarray, "draws pictures"]:
    """Return how many times each draw contains each picture's scene.

    Equal seeds and numbers of scenes give equal draws. `scene_of` has the scene of each picture.
    """
    ids, place = np.unique(np.asarray(scene_of), return_inverse=True)
    even = np.full(len(ids), 1 / len(ids))
    return np.random.default_rng(seed).multinomial(len(ids), even, size=draws)[:, place]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BootstrapFigure:
    """A figure with its value in each draw, so that differences and means get intervals, too.

    Figures from the same scenes and seed are paired, so their difference has the interval of a
    paired difference. Figures from different sets of scenes need different seeds.
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
    """Return each of `FIGURES` with its values in the draws."""
    return {
        name: BootstrapFigure(value=getattr(scores, name), draws=draws, scenes=scores.scenes)
        for name, draws in figures_of_draws(scores.matches, times).items()
    }


def with_intervals(scores: Scores, times: Int[np.ndarray, "draws pictures"]) -> dict[str, Interval]:
    """Return each of `FIGURES` with its interval."""
    return {name: figure.interval for name, figure in figures_with_draws(scores, times).items()}


def differences(
    scores: Scores, other: Scores, times: Int[np.ndarray, "draws pictures"]
) -> dict[str, Interval]:
    """Return the differences of `FIGURES` between two scores, paired by the scenes of each draw.

    Raises:
        GraycastError: the scores are from different scenes.
    """
    if scores.scene_ids != other.scene_ids:
        raise GraycastError(
            f"results of {len(scores.scene_ids)} scenes cannot be compared with results of "
            f"{len(other.scene_ids)} other scenes: give results of the same scenes"
        )
    mine, its = (figures_with_draws(one, times) for one in (scores, other))
    return {name: (mine[name] - its[name]).interval for name in mine}


def bootstrap(scores: Scores, figure: str, *, seed: int) -> BootstrapFigure:
    """Return one of `FIGURES` with its values in the draws."""
    return figures_with_draws(scores, draw_scenes(scores.scene_of, seed=seed))[figure]


def mean(figures: Sequence[BootstrapFigure]) -> BootstrapFigure:
    """Return the mean of figures from different sets of scenes."""
    return BootstrapFigure(
        value=float(np.mean([each.value for each in figures])),
        draws=np.mean([each.draws for each in figures], axis=0),
        scenes=min(each.scenes for each in figures),
    )


def interval_of(value: float, draws: Float[np.ndarray, " draws"], scenes: int) -> Interval:
    """Return the interval of a figure from its draws; the interval always contains the figure.

    Draws without instances to find are NaN; they are ignored.
    """
    draws = draws[~np.isnan(draws)]
    if scenes < 2 or not len(draws):
        return Interval(value=value, low=float("nan"), high=float("nan"))
    z = np.sqrt(scenes / (scenes - 1)) * stats.t.ppf((1 + LEVEL) / 2, scenes - 1)
    below, above = np.mean(draws < value - _EQUAL), np.mean(draws > value + _EQUAL)
    bias = np.clip(
        stats.norm.ppf((1 + below - above) / 2), -z / 2, z / 2
    )  # Values that equal the estimate count half.
    low, high = np.quantile(draws, stats.norm.cdf([2 * bias - z, 2 * bias + z]))
    return Interval(value=value, low=min(float(low), value), high=max(float(high), value))
