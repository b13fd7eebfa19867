"""Saturated areas of planes, whose depth is known in closed form."""

import numpy as np
import pytest

from graycast.real.material.saturated import continue_planes

HEIGHT, WIDTH = 60, 90
ROW, COLUMN = np.mgrid[:HEIGHT, :WIDTH]
PLANE_M = 1 / (1.6 + 1e-3 * ROW - 2e-3 * COLUMN)
HIGHLIGHT = (np.hypot(ROW - 30, COLUMN - 45) < 12) & (ROW % 7 > 0)


def test_a_highlight_gets_the_depth_of_its_plane():
    depth_m = np.where(HIGHLIGHT, np.nan, PLANE_M)
    assert np.allclose(continue_planes(depth_m, HIGHLIGHT), PLANE_M, rtol=1e-9)


def test_a_highlight_next_to_a_step_gets_the_plane_that_surrounds_it():
    """The higher surface is next to the highlight, and has fewer pixels around it."""
    stepped_m = np.where(COLUMN > 58, PLANE_M - 0.02, PLANE_M)
    filled_m = continue_planes(np.where(HIGHLIGHT, np.nan, stepped_m), HIGHLIGHT)
    assert np.allclose(filled_m[HIGHLIGHT], PLANE_M[HIGHLIGHT], rtol=1e-9)


@pytest.mark.parametrize("known", ["shadow", "nothing"])
def test_only_saturated_pixels_with_a_plane_around_them_are_filled(known):
    depth_m = np.where(HIGHLIGHT, np.nan, PLANE_M)
    saturated = HIGHLIGHT
    if known == "shadow":
        saturated = np.zeros_like(HIGHLIGHT)
    else:
        depth_m = depth_m + 0.02 * np.random.default_rng(0).random(depth_m.shape)
    filled_m = continue_planes(depth_m, saturated)
    assert np.array_equal(filled_m, depth_m, equal_nan=True)
