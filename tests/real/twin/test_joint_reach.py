"""How far a parameter may lie if others can make up for it: closed forms of a linear law."""

import numpy as np
import pytest

from graycast.real.twin.searching import joint_reach

FREE = 2 * np.sqrt(1 / 12)  # two standard deviations of an even law over a range of one


def test_a_row_that_hears_one_parameter_holds_it_by_its_slope():
    """Two standard deviations of a normal law times an even one's variance: 2 / sqrt(s^2 + 12)."""
    assert joint_reach(np.array([[10.0]]), room=4.0) == pytest.approx(2 / np.sqrt(100 + 12))
    assert joint_reach(np.array([[10.0]]), room=1.0) == pytest.approx(2 / np.sqrt(400 + 12))


def test_what_no_row_hears_lies_anywhere():
    assert joint_reach(np.zeros((3, 2)), room=1.0) == pytest.approx([FREE, FREE])


def test_two_parameters_that_make_up_for_each_other_are_both_open():
    """The rows hear the sum alone, so each goes as far as the other can follow."""
    held = joint_reach(np.array([[100.0, 100.0]]), room=1.0)
    assert held == pytest.approx([FREE / np.sqrt(2)] * 2, rel=1e-3)
    assert joint_reach(np.array([[100.0, 0.0]]), room=1.0)[0] < 0.02


def test_a_row_that_hears_them_apart_holds_both():
    both = joint_reach(np.array([[100.0, 100.0], [100.0, -100.0]]), room=1.0)
    assert both.max() < 0.02
