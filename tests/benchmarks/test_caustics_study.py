"""The definition of a firefly, and the share of the light that fireflies have."""

import numpy as np
import pytest

from benchmarks.caustics import fireflies


def test_the_light_of_a_firefly_is_the_excess_over_its_neighbours():
    """A pixel 11 times as bright as the rest is a firefly; one twice as bright is not."""
    white = np.ones((20, 20))
    white[10, 10], white[4, 4] = 11.0, 2.0
    everywhere = np.ones_like(white, dtype=bool)
    assert fireflies(white, everywhere) == pytest.approx(10 / white.sum())
    elsewhere = everywhere.copy()
    elsewhere[10, 10] = False
    assert fireflies(white, elsewhere) == 0
