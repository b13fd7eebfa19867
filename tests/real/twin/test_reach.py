"""How far a parameter may lie if others can make up for it: closed forms of a linear law."""

import numpy as np
import pytest

from graycast.real.twin.searching import reach_of

FREE = 2 * np.sqrt(1 / 12)  # two standard deviations of an even law over a range of one


def test_a_row_that_hears_one_parameter_bounds_it_by_its_slope():
    """Two standard deviations of a normal law times an even one's variance: 2 / sqrt(s^2 + 12)."""
    assert reach_of(np.array([[10.0]])) == pytest.approx(2 / np.sqrt(100 + 12))
    assert reach_of(np.array([[10.0], [24.0]])) == pytest.approx(2 / np.sqrt(26**2 + 12))


def test_what_no_row_hears_lies_anywhere():
    assert reach_of(np.zeros((3, 2))) == pytest.approx([FREE, FREE])


def test_two_parameters_that_make_up_for_each_other_are_both_open():
    """The rows hear the sum alone, so each goes as far as the other can follow."""
    reach = reach_of(np.array([[100.0, 100.0]]))
    assert reach == pytest.approx([FREE / np.sqrt(2)] * 2, rel=1e-3)
    assert reach_of(np.array([[100.0, 0.0]]))[0] < 0.02


def test_a_row_that_hears_them_apart_bounds_both():
    both = reach_of(np.array([[100.0, 100.0], [100.0, -100.0]]))
    assert both.max() < 0.02
