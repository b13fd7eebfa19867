"""Test the notes about results with equal scores or duplicate entries."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from graycast.score.evaluate import Protocol, score
from graycast.score.evaluate.judging import judge
from graycast.score.evaluate.task import ap_of_any_order, notes

from .drawn_sets import detected_squares, squares

PLACES = [(0, 0), (20, 0), (40, 0), (0, 20)]
WRONG = [(20, 35), (45, 30)]


def notes_of(places, scores):
    labels = [squares(0, PLACES)]
    detections = [detected_squares(0, places, scores)]
    judgement = judge(
        labels, detections, kind="box", categories={1: "a"}, protocol=Protocol(draws=2)
    )
    return list(notes([judgement]))


@pytest.mark.slow
def test_the_range_of_ap_covers_all_orders_of_equal_scores():
    """Oracle: all orders of six equal scores are scored one by one."""
    detections = detected_squares(0, [*PLACES, *WRONG], np.ones(6))
    every = []
    for order in permutations(range(6)):
        box_px = detections.box_px[list(order)]
        every.append(
            score([squares(0, PLACES)], [replace(detections, box_px=box_px)], kind="box").ap
        )
    low, high = ap_of_any_order(score([squares(0, PLACES)], [detections], kind="box").matches)
    assert (low, high) == pytest.approx((min(every), max(every)), abs=1e-12)
    assert high - low > 0.3


def test_equal_scores_that_change_ap_cause_a_note():
    (note,) = notes_of([*PLACES, *WRONG], np.ones(6))
    assert "all scores are equal" in note and "it is 1.000" in note and "0.667 to 1.000" in note
    (note,) = notes_of([*PLACES, *WRONG], [0.9, 0.8, 0.7, 0.7, 0.7, 0.6])
    assert "box: scores are equal" in note
    assert notes_of([*PLACES, *WRONG], np.linspace(0.9, 0.1, 6)) == []
    assert notes_of(PLACES, np.ones(4)) == []  # Without mistakes, the order does not matter.


def test_repeated_entries_are_counted():
    (note,) = notes_of([*PLACES, *PLACES[:3]], [0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3])
    assert note.startswith("3 detections repeat another one")
