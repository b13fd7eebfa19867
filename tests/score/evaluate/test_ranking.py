"""The area under the ROC curve, against counts by hand and against the curve itself."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from graycast.score.evaluate.shares import roc_auc, roc_auc_of_scenes


def test_the_area_is_the_share_of_pairs_in_order():
    score = np.array([0.9, 0.5, 0.5, 0.1, 0.3])
    success = np.array([True, True, False, False, True])
    # Pairs (success, failure): 0.9 wins both; 0.5 ties one and wins one; 0.3 loses one, wins one.
    assert roc_auc(score, success) == pytest.approx((2 + 1.5 + 1) / 6)


def test_the_area_equals_the_u_statistic_of_mann_and_whitney():
    """Oracle: the Mann-Whitney U test of SciPy."""
    rng = np.random.default_rng(5)
    success = rng.random(300) < 0.3
    score = np.round(rng.random(300) + 0.3 * success, 1)
    u = mannwhitneyu(score[success], score[~success]).statistic
    assert roc_auc(score, success) == pytest.approx(u / (success.sum() * (~success).sum()))


def test_the_area_equals_the_integral_under_the_curve():
    """Oracle: true over false positive rates at all thresholds, by trapezia; ties make slopes."""
    rng = np.random.default_rng(0)
    success = rng.random(400) < 0.4
    score = np.round(rng.normal(success * 0.8, 1.0), 1)
    threshold = np.concatenate([[np.inf], np.unique(score)[::-1]])
    true = (score[success] >= threshold[:, None]).mean(axis=1)
    false = (score[~success] >= threshold[:, None]).mean(axis=1)
    assert roc_auc(score, success) == pytest.approx(np.trapezoid(true, false), rel=1e-12)


def test_the_area_is_nan_without_failures():
    figure = roc_auc_of_scenes(np.ones(4), np.ones(4, bool), np.arange(4), seed=0)
    assert np.isnan([figure.value, figure.low, figure.high]).all()


@pytest.mark.slow
def test_the_interval_contains_the_truth_at_its_stated_rate():
    """For two normal laws that are one sigma apart, the area is Phi(1 / sqrt 2) = 0.760."""
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(40):
        success = rng.random(120) < 0.5
        score = rng.normal(success * 1.0, 1.0)
        figure = roc_auc_of_scenes(score, success, np.arange(120) // 4, seed=0)
        inside += figure.low <= 0.7602 <= figure.high
    assert inside >= 34  # At 95 %, fewer than 34 of 40 occur by chance once in 300 runs.


@pytest.mark.slow
def test_correlation_within_scenes_widens_the_interval():
    """Four equal grips in a scene have less information than four independent grips."""
    rng = np.random.default_rng(2)
    success = np.repeat(rng.random(40) < 0.5, 4)
    score = np.repeat(rng.normal(success[::4] * 1.0, 1.0), 4)
    alone = roc_auc_of_scenes(score, success, np.arange(160), seed=0)
    shared = roc_auc_of_scenes(score, success, np.arange(160) // 4, seed=0)
    assert shared.value == alone.value
    assert shared.high - shared.low > 1.5 * (alone.high - alone.low)
