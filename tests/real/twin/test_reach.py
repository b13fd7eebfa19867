"""Intervals of parameters, compared with closed forms for linear rows."""

import numpy as np
import pytest

from graycast.real.twin.searching import reach_of

FREE = 2 * np.sqrt(1 / 12)  # two standard deviations of a uniform distribution over 0 to 1


def test_a_row_that_depends_on_one_parameter_bounds_the_parameter_by_its_slope():
    """The precisions of row (s^2) and prior (12) add: two deviations are 2 / sqrt(s^2 + 12)."""
    assert reach_of(np.array([[10.0]])) == pytest.approx(2 / np.sqrt(100 + 12))
    assert reach_of(np.array([[10.0], [24.0]])) == pytest.approx(2 / np.sqrt(26**2 + 12))


def test_a_parameter_without_an_effect_is_unbounded():
    assert reach_of(np.zeros((3, 2))) == pytest.approx([FREE, FREE])


def test_parameters_that_compensate_each_other_are_unbounded():
    """The row depends only on the sum, so one parameter can compensate the other."""
    reach = reach_of(np.array([[100.0, 100.0]]))
    assert reach == pytest.approx([FREE / np.sqrt(2)] * 2, rel=1e-3)
    assert reach_of(np.array([[100.0, 0.0]]))[0] < 0.02


def test_a_row_that_separates_two_parameters_makes_them_bounded():
    both = reach_of(np.array([[100.0, 100.0], [100.0, -100.0]]))
    assert both.max() < 0.02
