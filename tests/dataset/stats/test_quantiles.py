"""Figures of histograms over whole numbers, without a dataset."""

import numpy as np
import pytest

from graycast.dataset.stats.gather import _quantiles, error_figures


def test_quantiles_of_a_histogram_equal_those_of_numpy():
    value = np.random.default_rng(3).poisson(40, 5001) - 20
    counts = {int(k): int((value == k).sum()) for k in np.unique(value)}
    shares = (0.01, 0.25, 0.5, 0.9, 0.999)
    expected = np.quantile(value, shares, method="inverted_cdf")
    np.testing.assert_array_equal(_quantiles(counts, shares), expected)


def test_median_and_rms_of_a_single_value_equal_the_value():
    error = error_figures({30: 10}, 0.1)
    assert error.median_mm == pytest.approx(3.0)
    assert error.rms_mm == pytest.approx(3.0)
    assert (error.beyond_1mm, error.beyond_5mm) == (1.0, 0.0)


def test_rounding_does_not_change_the_median_and_deviation_of_errors():
    """Errors are normal: mean 0.3, sigma 2 steps; rounding adds a variance of 1/12 (Sheppard)."""
    value = np.random.default_rng(4).normal(0.3, 2.0, 200_000)
    step, count = np.unique(np.rint(value).astype(int), return_counts=True)
    error = error_figures(dict(zip(step.tolist(), count.tolist(), strict=True)), 1.0)
    sigma, root = np.sqrt(4 + 1 / 12), np.sqrt(value.size)
    assert error.median_mm == pytest.approx(0.3, abs=0.02)  # 3.5 standard errors, 1.25 sigma / root
    assert error.sigma_mm == pytest.approx(sigma, rel=0.02)
    assert error.rms_mm == pytest.approx(np.hypot(sigma, 0.3), abs=4 * sigma / root)
