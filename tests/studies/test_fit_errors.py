"""The study of the errors of a fit: what it removes from the pixels of a scan."""

import numpy as np
import pytest

from graycast.real.material import Reflections
from studies import fit_errors

SIDE = 60
UP = np.array([0.0, 0.0, -1.0])


def pixels_of(normal, sigma_rad=0.01):
    """Return the pixels of a square picture, one after another, with camera and projector above."""
    count = SIDE * SIDE
    above = np.tile(UP, (count, 1))
    return Reflections(
        normal=normal,
        to_camera=above,
        to_projector=above,
        light=np.full(count, 2.0),
        sigma=np.full(count, 0.1),
        clipped=np.zeros(count, dtype=bool),
        normal_sigma_rad=np.full(count, sigma_rad),
        area_px=np.full(count, 25.0),
        pixel=np.argwhere(np.ones((SIDE, SIDE), dtype=bool)),
        point_m=above,
    )


def test_normals_with_their_stated_errors_have_a_ratio_of_one():
    rng = np.random.default_rng(0)
    tilted = UP + np.pad(0.01 * rng.normal(size=(SIDE * SIDE, 2)), ((0, 0), (0, 1)))
    tilted /= np.linalg.norm(tilted, axis=-1, keepdims=True)
    truth = np.tile(UP, (SIDE, SIDE, 1))
    truth[0, 0] = np.nan
    assert fit_errors.error_over_sigma(pixels_of(tilted), truth) == pytest.approx(1, abs=0.04)
    small = pixels_of(tilted, sigma_rad=0.005)
    assert fit_errors.error_over_sigma(small, truth) == pytest.approx(2, abs=0.08)


def test_true_normals_replace_those_of_the_scan_and_steep_pixels_are_left_out():
    truth = np.tile(UP, (SIDE, SIDE, 1))
    truth[:10] = [1.0, 0.0, 0.0]
    truth[10] = np.nan
    own = fit_errors.with_normals(pixels_of(np.tile([0.0, 0.6, -0.8], (SIDE * SIDE, 1))), truth)
    assert len(own) == SIDE * (SIDE - 11)
    assert (own.normal == UP).all()


def test_light_is_divided_by_the_share_where_the_share_is_known():
    share = np.full((SIDE, SIDE), 1.25)
    share[0], share[1] = np.nan, 0.0
    own = fit_errors.without_share(pixels_of(np.tile(UP, (SIDE * SIDE, 1))), share)
    assert len(own) == SIDE * (SIDE - 2)
    assert (own.light == 1.6).all() and (own.sigma == 0.08).all()
