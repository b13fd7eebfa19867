"""Speckle on the sensor: its contrast, grain and laws, and its effect on positions and depth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stage import centred, make_rig

from graycast.camera.decode import DepthMap, Reason
from graycast.camera.decode.maps import CodeMap
from graycast.camera.sensor import SensorSpec
from graycast.camera.sigma import speckle_m, with_depth_term
from graycast.camera.speckle import (
    Speckle,
    draw_speckle,
    footprint_px,
    material_contrast,
    pixel_contrast,
    shared_light,
    speckled,
)

RED = SensorSpec(wavelength_m=637e-9, f_number=4.0, pixel_pitch_m=6.9e-6)
FINE = replace(RED, pixel_pitch_m=2e-6)  # pixels as small as speckles
SHAPE = (400, 420)


def field(contrast, *, sensor=RED, seed=1):
    return draw_speckle(np.full(SHAPE, contrast), sensor, seed=seed)


# --- number of speckles in a pixel --------------------------------------------------------------


@pytest.mark.parametrize("sensor", [RED, FINE])
def test_the_number_of_speckles_per_pixel_follows_goodman_s_formula(sensor):
    """Goodman 2007: M of a square in Gaussian speckle, by the ratio of areas r = Sm / Sc:
    `sqrt(1/r) erf(sqrt(pi r)) - (1 - exp(-pi r)) / (pi r)`, and M is one over its square.
    """
    grain_m = sensor.wavelength_m * sensor.f_number
    r = sensor.pixel_pitch_m**2 / (4 / math.pi * grain_m**2)
    root = math.erf(math.sqrt(math.pi * r)) / math.sqrt(r)
    root -= (1 - math.exp(-math.pi * r)) / (math.pi * r)
    assert pixel_contrast(sensor) ** 2 == pytest.approx(root**2, rel=1e-9)


@pytest.mark.slow
def test_speckle_of_a_round_pupil_gives_the_same_contrast_within_8_percent():
    """Oracle: random phases through a round pupil by Fourier transform, summed over pixels. The
    Gaussian of the law lacks the rings of Airy's pattern: 6 % at two speckles per pixel.
    """
    n, pupil_px = 1024, 128  # samples per speckle: lambda N / sample = n / pupil
    y, x = np.mgrid[:n, :n] - n / 2
    pupil = np.hypot(x, y) <= pupil_px / 2
    light = []
    for seed in range(3):
        phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (n, n))
        intensity = np.abs(np.fft.fft2(np.exp(1j * phase) * pupil)) ** 2
        light.append(intensity / intensity.mean())
    assert np.std(light) == pytest.approx(1, abs=0.03)  # fully developed
    grain = n / pupil_px
    for pixel in (8, 16, 32):  # 1, 2 and 4 times lambda N
        summed = np.stack(light).reshape(3, n // pixel, pixel, n // pixel, pixel).mean(axis=(2, 4))
        scale = RED.wavelength_m * RED.f_number / grain
        sensor = replace(RED, pixel_pitch_m=pixel * scale)
        few = 3 / math.sqrt(2 * summed.size)
        assert pixel_contrast(sensor) == pytest.approx(summed.std(), rel=0.08 + few)
        beside = (summed[..., 1:] - 1) * (summed[..., :-1] - 1)
        expected = shared_light(sensor, 1) * shared_light(sensor, 0)
        assert expected == pytest.approx(beside.mean(), abs=0.06 * summed.var())


# --- the pattern -------------------------------------------------------------------------------


@pytest.mark.parametrize("contrast", [0.05, 0.3, 1.0])
def test_speckle_conserves_light_and_has_the_requested_contrast(contrast):
    bright = field(contrast).brightness.astype(float)
    n = bright.size
    assert bright.min() >= 0
    assert bright.mean() == pytest.approx(1, abs=5 * contrast / math.sqrt(n))
    # A gamma law's fourth moment is 3 + 6 C^2; correlated neighbours increase both errors a little.
    error = math.sqrt((2 + 6 * contrast**2) / n)
    assert bright.std() == pytest.approx(contrast, rel=0.006 + 2.5 * error)
    skew = ((bright - 1) ** 3).mean() / bright.std() ** 3
    assert skew == pytest.approx(2 * contrast, abs=0.06)


@pytest.mark.parametrize("sensor", [RED, FINE])
def test_neighbouring_pixels_correlate_by_the_speckles_that_they_share(sensor):
    one = field(0.05, sensor=sensor)
    for image in (one.brightness - 1, one.right_px, one.down_px):
        image = image.astype(float)
        for lag in (1, 2):
            expected = shared_light(sensor, lag) / shared_light(sensor, 0)
            for a, b in ((image[lag:], image[:-lag]), (image[:, lag:], image[:, :-lag])):
                correlation = (a * b).mean() / (image**2).mean()
                assert correlation == pytest.approx(expected, abs=0.02)


def test_one_seed_gives_one_speckle_pattern_and_two_seeds_are_unrelated():
    a, b, c = field(0.2, seed=0), field(0.2, seed=0), field(0.2, seed=1)
    assert np.array_equal(a.brightness, b.brightness) and np.array_equal(a.right_px, b.right_px)
    n = a.brightness.size
    for x, y in (
        (a.brightness - 1, c.brightness - 1),
        (a.right_px, c.right_px),
        (a.right_px, a.down_px),
        (a.right_px, a.brightness - 1),
    ):
        assert abs((x * y).mean()) < 4 * x.std() * y.std() / math.sqrt(n)


def test_many_small_speckles_move_the_centre_of_a_pixel_as_stated():
    """Oracle: pixels of 24 x 24 points with independent exponential light (speckles smaller than a
    point) have the contrast 1 / 24 and the centre of their weights.
    """
    rng = np.random.default_rng(3)
    weight = rng.exponential(size=(4000, 24, 24))
    place = (np.arange(24) - 11.5) / 24
    centre = (weight.sum(axis=1) @ place) / weight.sum(axis=(1, 2))
    coarse = replace(RED, pixel_pitch_m=1e-3)  # lambda N / pi is negligible
    shift_px = draw_speckle(np.full(SHAPE, 1 / 24), coarse, seed=2).right_px
    assert shift_px.std() == pytest.approx(centre.std(), rel=3 / math.sqrt(2 * 4000))


def test_speckle_moves_the_centre_of_a_pixel_by_the_law_of_dorsch_et_al():
    """delta x = C lambda / (2 pi sin u), sin u = 1 / (2 N) on the sensor; for any large pixel, the
    product of contrast and footprint is of the same order: the law is independent of pixels.
    """
    sin_u = 1 / (2 * RED.f_number)
    law_m = RED.wavelength_m / (2 * math.pi * sin_u)
    tiny = replace(RED, pixel_pitch_m=1e-8)
    assert pixel_contrast(tiny) * footprint_px(tiny) * 1e-8 == pytest.approx(law_m, rel=1e-3)
    for pitch_m in (5e-6, 1e-5, 1e-4):
        sensor = replace(RED, pixel_pitch_m=pitch_m)
        error_m = pixel_contrast(sensor) * footprint_px(sensor) * pitch_m
        assert 0.8 * law_m < error_m < 1.25 * law_m


# --- material -----------------------------------------------------------------------------------


def test_the_path_of_light_in_white_material_agrees_with_a_random_walk():
    """Oracle: photons on a line turn after exponential paths of mean 1 and are absorbed with k dl:
    two fluxes, as in Kubelka and Munk. The result is the mean path of returning light, weighted by
    it.
    """
    rng = np.random.default_rng(4)
    count = 40_000
    depth, path = np.zeros(count), np.zeros(count)
    back = np.zeros(count, dtype=bool)
    for turn in range(300):
        way = rng.exponential(size=count)
        here = np.minimum(way, depth) if turn % 2 else way  # the path ends at the surface
        path += np.where(back, 0, here)
        back |= (turn % 2 == 1) & (way > depth)
        depth += -here if turn % 2 else here
    for absorbed in (0.1, 0.5, 2.0):  # k / s
        left = np.where(back, np.exp(-absorbed * path), 0)
        R = left.mean()
        contrast = material_contrast(np.array([R]), 3.0)[0]
        mean_path = (left * path).sum() / left.sum()
        assert contrast == pytest.approx(1 / math.sqrt(1 + 3.0 * mean_path), rel=0.02)
    assert material_contrast(np.array([0.0, 0.7]), 0.0).tolist() == [1, 1]
    assert material_contrast(np.array([0.0]), 9.0)[0] == 1


# --- effect on pictures -------------------------------------------------------------------------


def ramp_speckle(right, down, bright=1.0):
    shape = (12, 14)
    return Speckle(
        brightness=np.full(shape, bright),
        right_px=np.full(shape, right),
        down_px=np.full(shape, down),
    )


def test_speckle_samples_a_ramp_of_light_at_the_displaced_centre():
    y, x = np.mgrid[:12, :14].astype(np.float32)
    stack = np.stack([5 + 3 * x, 90 - 2 * y, 0 * x + 7])
    picture = speckled(stack, ramp_speckle(0.2, -0.3, 1.1))[:, 1:-1, 1:-1] / 1.1
    inner = stack[:, 1:-1, 1:-1]
    assert np.allclose(picture, inner + np.array([0.6, 0.6, 0])[:, None, None], atol=1e-4)


def test_speckle_moves_no_light_across_a_silhouette_and_gives_none_below_zero():
    stack = np.full((1, 12, 14), 0.01, dtype=np.float32)
    stack[:, :, 7:] = 5.0
    for right in (-0.5, 0.5):
        assert np.array_equal(speckled(stack, ramp_speckle(right, 0.0)), stack)
    wild = np.random.default_rng(5).exponential(size=(3, 12, 14)).astype(np.float32)
    assert speckled(wild, ramp_speckle(0.5, -0.5)).min() >= 0


# --- what sigma includes -------------------------------------------------------------------------


def test_sigma_of_a_tilted_plane_agrees_with_the_errors_from_speckle():
    """Oracle: similar triangles on a tilted plane z = z0 / (1 - s x): the column of x + d is
    triangulated at x.
    """
    f_px, b_m = 300.0, 0.2
    rig = make_rig(centred(420, 400, f_px), centred(900, 800, 600.0), baseline_m=(b_m, 0, 0))
    x = (np.arange(420) - 209.5) / f_px
    off_px = 0.1
    d = off_px / f_px * np.random.default_rng(6).standard_normal((400, 420))
    for slope in (-0.8, 0.0, 0.8):
        inverse = (1 - slope * (x + d)) / 0.9
        column = 600.0 * (x + d - b_m * inverse) + 449.5
        depth = b_m / (x - (column - 449.5) / 600.0)
        codes = _codes(column)
        spread = np.full(column.shape, 1e-9, dtype=np.float32)
        du_dz = 600.0 * b_m / depth**2
        plain = DepthMap(
            depth_m=depth.astype(np.float32),
            sigma_m=(codes.sigma_column / du_dz).astype(np.float32),
            reason=np.full(column.shape, int(Reason.DECODED), dtype=np.uint8),
            camera=rig.camera,
        )
        off_map_px = spread + np.float32(off_px)
        displaced = with_depth_term(plain, speckle_m(plain, codes, rig, off_map_px))
        error = depth - 0.9 / (1 - slope * x)
        inside = np.s_[2:-2, 2:-2]
        assert np.std((error / displaced.sigma_m)[inside]) == pytest.approx(1, rel=0.02)


def _codes(column):
    nothing = np.full(column.shape, np.nan, dtype=np.float32)
    return CodeMap(
        column=column.astype(np.float32),
        row=nothing,
        sigma_column=np.full(column.shape, 1e-3, dtype=np.float32),
        sigma_row=nothing.copy(),
        modulation=np.full(column.shape, 0.5, dtype=np.float32),
        reason=np.zeros(column.shape, dtype=np.uint8),
    )


def test_a_half_sensitive_pixel_equals_every_second_pixel_of_a_finer_sensor():
    finer = replace(RED, pixel_pitch_m=RED.pixel_pitch_m / 2)
    for lag in (0, 1, 2):
        assert shared_light(RED, lag, side=0.5) == pytest.approx(
            shared_light(finer, 2 * lag), rel=1e-9, abs=1e-12
        )
    assert 2 * footprint_px(RED, side=0.5) == pytest.approx(footprint_px(finer), rel=1e-9)
    shift_px = draw_speckle(np.full(SHAPE, 0.1), RED, seed=1, side=0.5).right_px
    assert shift_px.std() == pytest.approx(0.1 * footprint_px(finer) / 2, rel=0.05)
