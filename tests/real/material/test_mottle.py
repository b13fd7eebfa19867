"""Mottle fitted to random fields with known spread and length, which pixels average."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from graycast.base.errors import GraycastError
from graycast.camera.decode import Levels
from graycast.real.material.mottle import FINEST, LENGTHS, fit_mottle
from graycast.world.parts import Material

SIZE_PX, FINE, PIXEL_M = 160, 4, 1e-3
ALL = np.ones((SIZE_PX, SIZE_PX), dtype=bool)


def fit_of(spread, length_px, *, noise_dn=0.0, use=None):
    """Fit a plane with light of 1000 DN, times 1 + spread times a random field.

    The field has normal values and the correlation exp(-(r / L)^2). It is made on squares of an
    eighth of a pixel, and each pixel takes their mean.
    """
    rng = np.random.default_rng(0)
    field = gaussian_filter(
        rng.standard_normal((SIZE_PX * FINE,) * 2), FINE * length_px / 2, mode="wrap"
    )
    field = (field / field.std()).reshape(SIZE_PX, FINE, SIZE_PX, FINE).mean(axis=(1, 3))
    slope = np.linspace(0.8, 1.2, SIZE_PX)  # A smooth change is no mottle.
    direct = 1000 * slope * (1 + spread * field)
    direct += math.sqrt(2) * noise_dn * rng.standard_normal(direct.shape)
    levels = Levels(
        offset_dn=0.0, saturation_dn=4095.0, floor_dn2=max(noise_dn**2, 1e-6), slope_dn=0.0
    )
    return fit_mottle(direct, ALL if use is None else use, levels, pixel_m=PIXEL_M, seed=0)


@pytest.mark.parametrize(("spread", "length_px"), [(0.1, 0.6), (0.1, 1.5), (0.05, 2.5)])
@pytest.mark.parametrize("noise_dn", [0.0, 20.0])
def test_spread_and_length_come_back_from_a_field_that_pixels_average(spread, length_px, noise_dn):
    fit = fit_of(spread, length_px, noise_dn=noise_dn)
    assert fit.spread.value == pytest.approx(spread, rel=0.1)
    assert fit.length_m.value == pytest.approx(length_px * PIXEL_M, rel=0.12)
    assert fit.spread.low <= fit.spread.value <= fit.spread.high < 1.3 * spread
    assert fit.limit == ""


@pytest.mark.parametrize(("length_px", "words"), [(0.2, "at most "), (8.0, "at least ")])
def test_a_length_outside_of_the_limits_is_stated_as_a_limit(length_px, words):
    fit = fit_of(0.1, length_px)
    assert fit.limit == words
    nearer_px = FINEST if words == "at most " else LENGTHS[-1]
    assert fit.length_m.value == pytest.approx(nearer_px * PIXEL_M)


def test_noise_alone_is_no_mottle():
    assert fit_of(0.0, 1.0, noise_dn=20.0).spread.value < 0.005


def test_a_bright_material_gets_as_much_mottle_as_energy_allows():
    fit = fit_of(0.2, 1.0)
    dark, bright = (fit.on(Material(base_color=(c,) * 3, metallic=1.0)) for c in (0.5, 0.9))
    assert dark.mottle == pytest.approx(fit.spread.value)
    assert bright.mottle < 0.07  # Its brightest place reflects all light.


def test_a_small_mask_is_refused():
    small = np.zeros_like(ALL)
    small[:30, :30] = True
    with pytest.raises(GraycastError, match="mark a larger area"):
        fit_of(0.1, 1.0, use=small)
