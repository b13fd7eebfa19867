"""The definition of a firefly, and its share of the light."""

import numpy as np
import pytest

from benchmarks.caustics import fireflies


def test_the_light_of_a_firefly_is_the_excess_over_its_neighbours():
    """Counted by hand: a pixel of 11 times the rest is a firefly, one of twice the rest is not."""
    white = np.ones((20, 20))
    white[10, 10], white[4, 4] = 11.0, 2.0
    everywhere = np.ones_like(white, dtype=bool)
    assert fireflies(white, everywhere) == pytest.approx(10 / white.sum())
    elsewhere = everywhere.copy()
    elsewhere[10, 10] = False
    assert fireflies(white, elsewhere) == 0
