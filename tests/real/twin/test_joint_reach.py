"""How far a parameter may lie if others can make up for it: closed forms of a linear law."""

import numpy as np
import pytest

from graycast.real.twin.searching import joint_reach, made_up

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


def test_the_others_move_to_where_the_rows_are_what_they_were():
    """A row hears the sum, so one goes down by what the other goes up; none leaves its range."""
    x = np.array([0.4, 0.5])
    place = made_up(x, np.zeros(1), np.array([[100.0, 50.0]]), 0, 0.5, room=1e-3)
    assert place == pytest.approx([0.5, 0.3], abs=1e-4)
    assert made_up(x, np.zeros(1), np.array([[100.0, 50.0]]), 0, 1.0, room=1e-3)[1] == 0.0


def test_others_that_no_row_hears_stay():
    x = np.array([0.4, 0.5])
    assert made_up(x, np.ones(1), np.array([[100.0, 0.0]]), 0, 0.5, room=1.0)[1] == 0.5
