"""Statistics of success rates: an interval, a test of two paired rates, and ROC curves."""

import math

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from .intervals import Interval, draw_scenes, interval_of


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a success rate (Wilson's score interval).

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
    JASA 22, 1927.
    """
    z = 1.959963984540054
    share, spread = hits / of, z * z / of
    middle = share + spread / 2
    half = z * math.sqrt(share * (1 - share) / of + spread / (4 * of))
    low, high = (middle - half) / (1 + spread), (middle + half) / (1 + spread)
    # With all or no hits, one end is exact; a rounding error would exclude the rate itself.
    return low if hits else 0.0, high if hits < of else 1.0


def mcnemar(only_first: int, only_second: int) -> float:
    """Return the two-sided p-value of McNemar's exact test.

    Args:
        only_first: number of pairs in which only the first trial is a success.
        only_second: number of pairs in which only the second trial is a success.

    Source: Q. McNemar, "Note on the sampling error of the difference between correlated
    proportions or percentages", Psychometrika 12, 1947.
    """
    if only_first + only_second == 0:
        return 1.0
    return float(stats.binomtest(only_first, only_first + only_second, 0.5).pvalue)


def roc_auc(score: Float[np.ndarray, " n"], success: Bool[np.ndarray, " n"]) -> float:
    """Return the area under the ROC curve, which measures how well a score predicts success.

    The area is the probability that a success has a higher score than a failure; ties count half.
    It is NaN without successes or without failures. It equals Mann and Whitney's U (the rank sum
    of the successes minus its smallest possible value) divided by the number of pairs.
    """
    good = int(success.sum())
    bad = len(success) - good
    if not good or not bad:
        return float("nan")
    u = stats.rankdata(score)[success].sum() - good * (good + 1) / 2
    return float(u / (good * bad))


def roc_auc_of_scenes(
    score: Float[np.ndarray, " n"],
    success: Bool[np.ndarray, " n"],
    scene: Int[np.ndarray, " n"],
    *,
    seed: int,
) -> Interval:
    """Return the area under the ROC curve with its interval from resampled scenes."""
    ids, place = np.unique(scene, return_inverse=True)
    draws = []
    for times in draw_scenes(ids.tolist(), seed=seed) if len(ids) > 1 else ():
        index = np.repeat(np.arange(len(score)), times[place])
        draws.append(roc_auc(score[index], success[index]))
    return interval_of(roc_auc(score, success), np.array(draws), len(ids))
