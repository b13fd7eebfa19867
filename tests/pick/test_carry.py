"""What is remembered of failed grips between two attempts."""

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="needs pinocchio: pip install 'graycast[pick]'")

from graycast.pick.carry import FREED_M, _beyond

HERE = np.zeros(3)
NEAR, FAR = np.array([0.9 * FREED_M, 0.0, 0.0]), np.array([0.0, 1.1 * FREED_M, 0.0])


def test_what_was_near_a_taken_part_is_forgotten():
    assert _beyond((NEAR, FAR), HERE) == (FAR,)
    assert _beyond((FAR,), HERE) == (FAR,)
    assert _beyond((NEAR,), HERE) == ()
