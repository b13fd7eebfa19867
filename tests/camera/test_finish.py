"""Patches of a surface: the law of an uneven amplitude, its patches, a raster with it."""

import itertools
import math

import numpy as np
import pytest

from graycast.camera.decode import DepthMap
from graycast.camera.faults import on_raster
from graycast.camera.finish import PATCH_M, uneven

SHAPE = (400, 420)


def test_an_uneven_amplitude_has_its_spread_and_its_patches_and_no_more_power():
    mean, patch_px = 0.1, 8.0
    drawn = [uneven(np.full(SHAPE, mean), 0.3, patch_px=patch_px, seed=seed) for seed in range(6)]
    log = np.log(np.stack(drawn))
    assert log.std() == pytest.approx(0.3, rel=1e-3)
    assert np.mean(np.square(drawn)) == pytest.approx(mean**2, rel=0.03)
    rest = log - log.mean()
    for lag in (4, 8, 12):
        expected = math.exp(-((lag / patch_px) ** 2))
        for shifted in (np.roll(rest, lag, axis=1), np.roll(rest, lag, axis=2)):
            assert (rest * shifted).mean() / rest.var() == pytest.approx(expected, abs=0.05)
    common = [(a * b).mean() / rest.var() for a, b in itertools.combinations(rest, 2)]
    assert np.mean(common) == pytest.approx(0, abs=0.03)
    assert uneven(np.full(SHAPE, 0.9), 1.0, patch_px=patch_px, seed=0).max() == 1


def test_an_uneven_raster_moves_points_as_far_in_the_mean_but_in_patches():
    """On a plane in inverse depth the error is the slope times the place, whose squares have the
    law of `uneven`: even places have the kurtosis 9 / 5, uneven ones `exp(4 u^2)` times that.
    """
    u, slope = 0.2, 2e-4
    inverse = 1 + slope * np.arange(SHAPE[1]) + np.zeros(SHAPE)
    flat = DepthMap(
        depth_m=(1 / inverse).astype(np.float32),
        sigma_m=np.full(SHAPE, 1e-4, np.float32),
        reason=np.zeros(SHAPE, np.uint8),
    )
    focal_px = 2.0 / PATCH_M  # patches of two pixels: many, so that their law is met closely
    found = {}
    for unevenness in (0.0, u):
        z = on_raster(flat, 0.3, unevenness=unevenness, focal_px=focal_px).depth_m
        error = (1 / z.astype(np.float64) - inverse)[:, 1:-1] / slope
        found[unevenness] = error.std(), (error**4).mean() / error.var() ** 2
    assert found[0.0] == pytest.approx((0.3, 1.8), rel=0.02)
    assert found[u] == pytest.approx((0.3, 1.8 * math.exp(4 * u**2)), rel=0.04)
