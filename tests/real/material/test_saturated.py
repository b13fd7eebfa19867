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


def test_a_highlight_across_a_step_gets_the_plane_of_most_of_its_pixels():
    """A quarter of the pixels between the saturated ones are on a higher surface."""
    stepped_m = np.where((COLUMN > 51) & ~HIGHLIGHT, PLANE_M - 0.02, PLANE_M)
    filled_m = continue_planes(np.where(HIGHLIGHT, np.nan, stepped_m), HIGHLIGHT)
    assert np.allclose(filled_m[HIGHLIGHT], PLANE_M[HIGHLIGHT], rtol=1e-9)


@pytest.mark.parametrize("case", ["shadow", "whole facet", "no plane"])
def test_only_saturated_pixels_with_a_plane_between_them_are_filled(case):
    """Around a facet that is saturated as a whole is the depth of other facets."""
    depth_m = np.where(HIGHLIGHT, np.nan, PLANE_M)
    saturated = HIGHLIGHT
    if case == "shadow":
        saturated = np.zeros_like(HIGHLIGHT)
    elif case == "whole facet":
        saturated = np.hypot(ROW - 30, COLUMN - 45) < 12
        depth_m = np.where(saturated, np.nan, PLANE_M)
    else:
        depth_m = depth_m + 0.02 * np.random.default_rng(0).random(depth_m.shape)
    filled_m = continue_planes(depth_m, saturated)
    assert np.array_equal(filled_m, depth_m, equal_nan=True)
