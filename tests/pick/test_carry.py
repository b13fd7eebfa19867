"""What is remembered of failed grips between two attempts."""

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="needs pinocchio: pip install 'graycast[pick]'")

from graycast.pick.carry import FREED_M, _tabu

HERE = np.zeros(3)
NEAR, FAR = np.array([0.9 * FREED_M, 0.0, 0.0]), np.array([0.0, 1.1 * FREED_M, 0.0])


def test_a_failed_place_is_remembered_until_something_near_it_is_taken():
    failed = _tabu(_tabu((), NEAR, taken=False), FAR, taken=False)
    assert failed == (NEAR, FAR)
    assert _tabu(failed, HERE, taken=True) == (FAR,)
    assert _tabu((FAR,), HERE, taken=True) == (FAR,)
    assert _tabu((FAR,), HERE, taken=False) == (FAR, HERE)
