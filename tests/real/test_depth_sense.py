"""Depth of another unit, and holes that were filled with the farthest depth."""

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.real.depth_sense import filled_holes, refuse_beyond

RANGE = {"near_m": 0.67, "far_m": 1.0, "name": "a.png", "whose": "the detector learnt"}


def slope(rng, middle_m=0.88):
    """A floor that leans by 0.2 m, with noise of a millimetre, in steps of 0.02 mm."""
    depth_m = middle_m + np.linspace(-0.1, 0.1, 120)[None] + 1e-3 * rng.standard_normal((90, 120))
    return np.rint(depth_m / 2e-5) * 2e-5


@pytest.mark.parametrize("factor", [5, 0.02, 10, 0.1, 1000, 0.001, 25.4, 1 / 25.4])
def test_depth_of_another_unit_is_refused(factor):
    """The scales of a public report are 5 and 0.02; the others are mm, cm, 0.1 mm and inches."""
    depth_m = factor * slope(np.random.default_rng(0))
    with pytest.raises(
        DatasetError, match=r"a\.png: .*learnt 0\.67 to 1 m: .*another unit"
    ) as error:
        refuse_beyond(depth_m, **RANGE)
    assert f"{np.median(depth_m):.4g} m" in str(error.value)


@pytest.mark.parametrize("middle_m", [0.5, 0.88, 1.4])
def test_a_camera_that_stands_elsewhere_is_none_of_it(middle_m):
    refuse_beyond(slope(np.random.default_rng(1), middle_m), **RANGE)
    refuse_beyond(np.full((4, 4), np.nan), **RANGE)


def test_filled_holes_are_named_with_their_share_and_depth():
    rng = np.random.default_rng(2)
    depth_m = slope(rng)
    depth_m[rng.random(depth_m.shape) < 0.22] = np.max(depth_m)
    note = filled_holes(depth_m, "a.png")
    assert note.startswith("a.png: 22% ") or note.startswith("a.png: 21% ")
    assert f"{depth_m.max():.4g} m" in note and "write 0 or NaN" in note


@pytest.mark.parametrize("step_m", [2e-5, 1e-3, 2e-3])
def test_measured_depth_in_coarse_steps_is_not_taken_for_filled_holes(step_m):
    """A floor that faces the camera, with noise of 1 mm: its farthest step has few pixels."""
    rng = np.random.default_rng(3)
    flat = np.rint((0.88 + 1e-3 * rng.standard_normal((90, 120))) / step_m) * step_m
    assert filled_holes(flat, "a.png") is None
    holed = slope(rng)
    holed[rng.random(holed.shape) < 0.22] = np.nan
    assert filled_holes(holed, "a.png") is None
    assert filled_holes(np.full((4, 4), np.nan), "a.png") is None
