"""Figures of a decoder, on results for which every figure is known by hand."""

import numpy as np
import pytest

from benchmarks.decoders import calibration_error, decoded_at_limit, is_wrong, reliability, worth
from graycast.score.evaluate.shares import roc_auc


def test_without_sigma_a_depth_off_by_more_than_1_mm_is_wrong():
    true_m = np.full(3, 0.8)
    depth_m = true_m + np.array([0.5e-3, 2e-3, 2e-3])
    assert is_wrong(depth_m, true_m).tolist() == [False, True, True]
    sigma_m = np.array([1e-5, 3e-4, 5e-4])
    assert is_wrong(depth_m, true_m, sigma_m).tolist() == [False, True, False]


def test_the_area_under_the_roc_counts_ordered_pairs_and_half_of_the_equal_ones():
    p_wrong = np.array([0.1, 0.4, 0.4, 0.9])
    wrong = np.array([False, False, True, True])
    assert roc_auc(p_wrong, wrong) == pytest.approx(3.5 / 4)
    assert np.isnan(roc_auc(p_wrong, np.zeros(4, bool)))


def test_the_calibration_error_weights_each_bin_by_its_number():
    p_wrong = np.array([0.2, 0.2, 0.2, 0.2, 0.95])
    wrong = np.array([True, False, False, False, True])
    bins = reliability(p_wrong, wrong)
    assert [(one.wrong, one.count) for one in bins] == [(0.25, 4), (1.0, 1)]
    assert calibration_error(bins) == pytest.approx((4 * 0.05 + 0.05) / 5)
    assert np.isnan(calibration_error([]))


def test_a_limit_of_p_wrong_includes_all_equal_probabilities():
    p_wrong = np.array([0.1, 0.1, 0.5, 0.5])
    wrong = np.array([False, False, False, True])
    assert decoded_at_limit(p_wrong, wrong, 8) == pytest.approx(2 / 8)
    assert decoded_at_limit(np.zeros(0), np.zeros(0, bool), 8) == 0.0


def test_shares_count_the_pixels_of_the_parts_alone():
    true_m = np.full((1, 5), 0.8)
    depth_m = true_m + np.array([[0.0, 2e-3, 0.0, np.nan, 9.0]])
    parts = np.array([[True] * 4 + [False]])
    p_wrong = np.array([[0.0, 1.0, 0.0, np.nan, 0.0]])
    figures = worth(depth_m, true_m, parts, p_wrong=p_wrong)
    assert figures.decoded == pytest.approx(3 / 4)
    assert figures.wrong == pytest.approx(1 / 3)
    assert (figures.roc_area, figures.calibration_error) == (1.0, 0.0)
    assert figures.decoded_at_limit == pytest.approx(2 / 4)
    assert worth(depth_m, true_m, parts).roc_area is None
