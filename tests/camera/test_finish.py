"""Patches of a surface: the law of an uneven amplitude, and the size of the patches."""

import itertools
import math

import numpy as np
import pytest

from graycast.camera.speckle import uneven

SHAPE = (400, 420)


def test_an_uneven_finish_has_the_stated_spread_and_patches_and_the_same_power():
    mean, patch_px = 0.1, 8.0
    amplitudes = [
        uneven(np.full(SHAPE, mean), 0.3, patch_px=patch_px, seed=seed) for seed in range(6)
    ]
    log = np.log(np.stack(amplitudes))
    assert log.std() == pytest.approx(0.3, rel=1e-3)
    assert np.mean(np.square(amplitudes)) == pytest.approx(mean**2, rel=0.03)
    rest = log - log.mean()
    for lag in (4, 8, 12):
        expected = math.exp(-((lag / patch_px) ** 2))
        for shifted in (np.roll(rest, lag, axis=1), np.roll(rest, lag, axis=2)):
            assert (rest * shifted).mean() / rest.var() == pytest.approx(expected, abs=0.05)
    common = [(a * b).mean() / rest.var() for a, b in itertools.combinations(rest, 2)]
    assert np.mean(common) == pytest.approx(0, abs=0.03)
    assert uneven(np.full(SHAPE, 0.9), 1.0, patch_px=patch_px, seed=0).max() == 1
