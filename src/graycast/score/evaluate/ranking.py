"""The area under the ROC curve, which states how well a score predicts success."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import rankdata

from .intervals import Interval, draw_scenes, interval_of


def roc_auc(score: Float[np.ndarray, " n"], success: Bool[np.ndarray, " n"]) -> float:
    """The probability that a success has a higher score than a failure; ties count half.

    NaN where nothing succeeds, or everything. It is Mann and Whitney's U, as a share of all pairs:
    the sum of the successes' ranks, less the least that it can be.
    """
    good = int(success.sum())
    bad = len(success) - good
    if not good or not bad:
        return float("nan")
    u = rankdata(score)[success].sum() - good * (good + 1) / 2
    return float(u / (good * bad))


def roc_auc_of_scenes(
    score: Float[np.ndarray, " n"],
    success: Bool[np.ndarray, " n"],
    scene: Int[np.ndarray, " n"],
    *,
    seed: int,
) -> Interval:
    """The same with its interval by resampling of scenes."""
    ids, place = np.unique(scene, return_inverse=True)
    draws = []
    for times in draw_scenes(ids.tolist(), seed=seed) if len(ids) > 1 else ():
        index = np.repeat(np.arange(len(score)), times[place])
        draws.append(roc_auc(score[index], success[index]))
    return interval_of(roc_auc(score, success), np.array(draws), len(ids))
