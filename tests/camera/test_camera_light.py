"""Laws of the black level and of the veil."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from stage import centred, make_rig

from graycast.camera.light import camera_light, veiled
from graycast.rendering import Radiance

RNG = np.random.default_rng(4)


def radiance(h=48, w=64, n=3):
    white = RNG.uniform(0.5, 2.0, (h, w)).astype(np.float32)
    share = RNG.uniform(0.0, 1.0, (n, h, w)).astype(np.float32)
    share[0] = 1
    colour = np.zeros((h, w, 3), dtype=np.float32)
    return Radiance(
        pattern=share * white,
        white=white,
        ambient=RNG.uniform(0.0, 0.2, (h, w)).astype(np.float32),
        white_rgb=colour, ambient_rgb=colour.copy(), albedo=colour.copy(),
    )  # fmt: skip


def rig(**words):
    return make_rig(centred(64, 48, 50), centred(32, 24, 30), **words)


def test_a_scanner_without_leaks_returns_the_renderer_s_own_arrays():
    light = radiance()
    stack, background = camera_light(light, rig())
    assert stack is light.pattern and background is light.ambient


@pytest.mark.parametrize("veil", [0.0, 0.1])
def test_a_black_pattern_gives_white_light_divided_by_the_contrast_ratio(veil):
    """The field is flat, so the veil changes neither."""
    flat = np.full((48, 64), 3.0, dtype=np.float32)
    colour = np.zeros((48, 64, 3), dtype=np.float32)
    pattern = np.stack([flat, 0 * flat, flat / 2])
    light = Radiance(
        pattern=pattern, white=flat, ambient=flat / 10,
        white_rgb=colour, ambient_rgb=colour.copy(), albedo=colour.copy(),
    )  # fmt: skip
    stack, background = camera_light(light, rig(contrast_ratio=200.0, veil=veil))
    assert np.allclose(stack[0], 3.0, rtol=1e-5)
    assert np.allclose(stack[0] / stack[1], 200, rtol=1e-4)
    assert np.allclose(stack[2], (stack[0] + stack[1]) / 2, rtol=1e-5)
    assert np.allclose(background, 0.3, rtol=1e-5)
    assert pattern is light.pattern and np.array_equal(light.pattern[0], flat)


def test_the_lens_spreads_projected_and_ambient_light_alike():
    """Light adds: pattern and other light with a veil each are the veil of their sum."""
    light = radiance()
    stack, background = camera_light(light, rig(veil=0.2))
    for k, pattern in enumerate(light.pattern):
        whole = veiled(pattern + light.ambient, 0.2)
        assert np.allclose(stack[k] + background, whole, rtol=1e-4)
        assert not np.allclose(stack[k] + light.ambient, whole, rtol=1e-3)


@pytest.mark.parametrize("size", [(772, 1032), (48, 64), (101, 333), (400, 150), (3, 5)])
def test_a_lens_veil_conserves_light_and_does_not_change_a_flat_picture(size):
    image = RNG.exponential(1.0, size).astype(np.float32)
    image[: size[0] // 9 + 1, : size[1] // 9 + 1] += 1000  # a lamp in the corner
    flat = np.full(size, 0.7, dtype=np.float32)
    assert veiled(image, 0.3).mean(dtype=float) == pytest.approx(image.mean(dtype=float), rel=2e-6)
    assert np.abs(veiled(flat, 0.3) - 0.7).max() < 1e-6


def test_a_lens_veil_is_linear_and_does_not_blur_unscattered_light():
    a, b = RNG.exponential(1.0, (2, 200, 300)).astype(np.float32)
    assert np.allclose(veiled(2 * a + b, 0.2), 2 * veiled(a, 0.2) + veiled(b, 0.2), atol=1e-5)
    halo = veiled(a, 0.2) - np.float32(0.8) * a
    assert np.abs(np.diff(halo, axis=1)).max() < 0.02 * np.abs(np.diff(a, axis=1)).max()
    assert np.array_equal(veiled(a, 0.0), a)


@pytest.mark.slow
def test_the_halo_around_a_light_is_the_mean_of_gaussians_of_all_octaves():
    """Oracle: SciPy's filter at full resolution with mirrored borders, far from the light, where
    the pixels of the small picture do not matter.
    """
    image = np.zeros((240, 320), dtype=np.float32)
    image[100:108, 150:158] = 1.0
    image[20:40, 280:300] = 0.3
    octaves = [gaussian_filter(image, 320 / 2**k, mode="reflect", truncate=6) for k in range(1, 7)]
    expected = 0.9 * image + 0.1 * np.mean(octaves, axis=0)
    error = np.abs(veiled(image, 0.1) - expected)
    assert error.max() < 0.05 * (0.1 * np.mean(octaves, axis=0)).max()
    y, x = np.mgrid[0:240, 0:320]
    far = (np.hypot(x - 153, y - 103) > 30) & (np.hypot(x - 290, y - 30) > 35)
    assert (error / expected)[far].max() < 0.02


def test_coarse_stripes_lose_less_contrast_than_fine_stripes():
    """Real stacks lose 1 to 3 % of modulation per bit, from coarse to fine."""
    x = np.arange(1024)
    modulation = []
    for period_px in (1024, 512, 256, 128, 64, 32):
        line = ((x // (period_px // 2)) % 2).astype(np.float32)
        image = np.broadcast_to(line, (768, 1024)).copy()
        picture, inverse = veiled(image, 0.1)[384], veiled(1 - image, 0.1)[384]
        modulation.append(float(np.abs(picture - inverse).mean()))
    losses = -np.diff(modulation)
    assert modulation[0] > 0.92 and modulation[-1] == pytest.approx(0.9, abs=0.005)
    assert (losses > -1e-6).all() and losses.max() < 0.03


def test_adding_lens_effects_does_not_change_the_arguments():
    light = radiance()
    before = [array.copy() for array in (light.pattern, light.white, light.ambient)]
    stack, background = camera_light(light, rig(contrast_ratio=50.0, veil=0.05))
    assert stack.dtype == background.dtype == np.float32 and stack.flags.writeable
    for array, copy in zip((light.pattern, light.white, light.ambient), before, strict=True):
        assert np.array_equal(array, copy)
    assert not math.isclose(stack.mean(), before[0].mean(), rel_tol=1e-3)
