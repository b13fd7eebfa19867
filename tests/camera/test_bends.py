"""Sigma where a surface bends: closed forms of a plane, of folds and of steps."""

from dataclasses import replace

import numpy as np
import pytest
from stage import centred

from graycast.camera.decode import DepthMap, Reason
from graycast.camera.sigma import bend_m, with_depth_term

SIGMA_M = 1e-4


def map_of(inverse):
    depth_m = (1 / np.asarray(inverse)).astype(np.float32)
    reason = np.where(np.isnan(depth_m), Reason.SHADOW, Reason.DECODED).astype(np.uint8)
    sigma_m = np.where(np.isnan(depth_m), np.nan, SIGMA_M).astype(np.float32)
    return DepthMap(depth_m=depth_m, sigma_m=sigma_m, reason=reason, camera=centred(40, 30, 100.0))


def with_bends(depth):
    return with_depth_term(depth, bend_m(depth))


def grid():
    return np.meshgrid(np.arange(40.0), np.arange(30.0))


@pytest.mark.parametrize("noise_sigmas", [0.0, 0.7])
def test_a_plane_without_a_bend_keeps_its_sigma(noise_sigmas):
    """A plane is linear in inverse depth at any slope; such small noise is no bend."""
    x, y = grid()
    inverse = 0.8 + 3e-3 * x - 2e-3 * y
    off = noise_sigmas * SIGMA_M * inverse**2 * np.random.default_rng(5).uniform(-1, 1, x.shape)
    plane = map_of(inverse + off)
    np.testing.assert_array_equal(with_bends(plane).sigma_m, plane.sigma_m)


@pytest.mark.parametrize("turn", [False, True])
def test_sigma_at_a_fold_increases_by_a_quarter_of_the_bend(turn):
    """The bend is the change of the slope within a pixel, only at the fold."""
    x, _ = grid()
    change = 4e-3  # change of inverse depth per pixel [1/m]
    inverse = 0.7 + change * np.abs(x - 20)
    fold = map_of(np.ascontiguousarray(inverse.T) if turn else inverse)
    sigma_m = with_bends(fold).sigma_m
    sigma_m, depth_m = (sigma_m.T, fold.depth_m.T) if turn else (sigma_m, fold.depth_m)
    noise2 = np.square(SIGMA_M * inverse[:, 19:22] ** 2) @ [1, 4, 1]
    bend = np.sqrt((2 * change) ** 2 - 4 * noise2)  # beyond two standard deviations of noise
    for beside in (19, 20, 21):
        expected = np.hypot(SIGMA_M, bend / 4 * depth_m[:, beside] ** 2)
        np.testing.assert_allclose(sigma_m[:, beside], expected, rtol=1e-3)
    np.testing.assert_array_equal(np.delete(sigma_m, (19, 20, 21), axis=1), np.float32(SIGMA_M))


def test_errors_at_pixels_that_a_step_crosses_agree_with_sigma():
    """A step divides each row at another position; a pixel there sees a share of both surfaces."""
    rng = np.random.default_rng(7)
    height, rows = 5e-3, 4000
    share = rng.uniform(0, 1, rows)
    depth_m = np.tile(np.where(np.arange(9) < 4, 1.0, 1.0 + height), (rows, 1))
    true_m = np.where(share > 0.5, 1.0, 1.0 + height)
    depth_m[:, 4] = 1.0 + (1 - share) * height
    scan = map_of(1 / (depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)))
    off = (scan.depth_m[:, 4] - true_m) / with_bends(scan).sigma_m[:, 4]
    assert 0.8 <= np.sqrt(np.mean(off**2)) <= 1.6
    assert (np.abs(off) > 5).mean() == 0
    assert (np.abs(scan.depth_m[:, 4] - true_m) > 5 * SIGMA_M).mean() > 0.5  # without the term


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize(("slope_deg", "bends"), [(73.0, True), (77.0, False)])
def test_a_step_steeper_than_75_degrees_is_no_bend(turn, slope_deg, bends):
    """Two surfaces meet there, and each keeps the sigma of its noise."""
    camera = replace(centred(40, 30, 400.0), fx_px=200.0)  # A pixel is twice as wide as high.
    pixel_m = 1 / (camera.fy_px if turn else camera.fx_px)
    x, y = grid()
    depth_m = 1.0 + np.tan(np.radians(slope_deg)) * pixel_m * ((y if turn else x) > 15)
    step = replace(map_of(1 / depth_m), camera=camera)
    changed = bend_m(step) > 0
    beside = np.isin(y if turn else x, (14, 15, 16, 17))
    np.testing.assert_array_equal(changed, beside if bends else np.zeros_like(beside))


def test_sigma_is_unchanged_next_to_a_hole_and_at_the_picture_s_border():
    x, _ = grid()
    inverse = 0.7 + 4e-3 * np.abs(x - 0.5)  # The surface folds between the first two columns.
    inverse[:, 2] = np.nan
    holed = map_of(inverse)
    np.testing.assert_array_equal(with_bends(holed).sigma_m, holed.sigma_m)
