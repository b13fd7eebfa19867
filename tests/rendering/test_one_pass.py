"""All patterns from one set of paths must equal each pattern rendered alone."""

import mitsuba_alone
import numpy as np
import pytest
from backends import slow
from corner import corner_scene
from noisy_pictures import agree, blocks
from stage import askew_rig, in_camera, lambert, leaning_wall, plain_pattern

from graycast.rendering import Quality
from graycast.rig.pattern import gray
from graycast.world.scene import EMPTY_LAYOUT

DEPTH = 3


def patterns_of(rig, names):
    code = gray(rig.projector.width_px, rig.projector.height_px)
    order = [frame.name for frame in code.frames]
    return code.render()[[order.index(name) for name in names]]


def one_pass_and_alone(renderer, names, *, seeds, samples):
    """Return blocks (seeds, patterns, blocks) of one pass, and of each pattern by Mitsuba alone."""
    scene, layout = corner_scene()
    pattern = patterns_of(scene.rig, names)
    quality = Quality(samples=samples, depth=DEPTH, footprint=False)
    together = np.stack(
        [
            renderer.render(scene, layout, pattern, quality=quality, seed=seed).radiance.pattern
            for seed in range(seeds)
        ]
    )
    alone = np.stack(
        [
            mitsuba_alone.render(
                scene, layout, image, samples=samples, depth=DEPTH, seeds=range(1000, 1000 + seeds)
            )
            for image in pattern
        ],
        axis=1,
    )
    return blocks(together.astype(float)), blocks(alone.astype(float))


@pytest.fixture(scope="module")
def quick_pair(mitsuba_renderer):
    return one_pass_and_alone(mitsuba_renderer, ["white", "column_bit01"], seeds=8, samples=25)


def test_rendering_all_patterns_in_one_pass_agrees_with_an_independent_integrator(quick_pair):
    """Mitsuba's path tracer with its own camera, projector and random numbers is independent of our
    loop. Patterns are compared one by one, since those of one pass share their errors.
    """
    together, alone = quick_pair
    for k in range(together.shape[1]):
        assert agree(together[:, k], alone[:, k])


@pytest.mark.slow
def test_the_comparison_detects_a_2_percent_error_and_a_missing_bounce(
    quick_pair, mitsuba_renderer
):
    together, alone = quick_pair
    for k in range(together.shape[1]):
        assert not agree(1.02 * together[:, k], alone[:, k])
        assert not agree(together[:, k], alone[:, (k + 1) % together.shape[1]])
    scene, layout = corner_scene()
    quality = Quality(samples=25, depth=DEPTH - 1, footprint=False)
    pattern = plain_pattern(scene.rig, 255)
    shallow = [
        mitsuba_renderer.render(scene, layout, pattern, quality=quality, seed=s).radiance.pattern
        for s in range(4)
    ]
    assert not agree(blocks(np.stack(shallow).astype(float))[:, 0], alone[:, 0])


@pytest.mark.slow
def test_one_pass_agrees_with_separate_patterns_to_a_third_of_a_percent(mitsuba_renderer):
    together, alone = one_pass_and_alone(
        mitsuba_renderer,
        ["white", "column_bit04", "column_bit01", "row_bit01"],
        seeds=16,
        samples=256,
    )
    for k in range(together.shape[1]):
        assert agree(together[:, k], alone[:, k])
        assert not agree(1.003 * together[:, k], alone[:, k])


@pytest.mark.slow
@pytest.mark.parametrize("levels", [slow(2), 256])
def test_a_pattern_in_a_stack_equals_its_separate_rendering_bit_for_bit(mitsuba_renderer, levels):
    """The stack's patterns share the same paths; 34 of them need more than one word of bits."""
    scene, layout = corner_scene()
    size = (34, scene.rig.projector.height_px, scene.rig.projector.width_px)
    pattern = np.random.default_rng(3).integers(0, levels, size) * (255 // (levels - 1))
    pattern = pattern.astype(np.uint8)
    quality = Quality(samples=2, depth=DEPTH, footprint=False)
    stack = mitsuba_renderer.render(scene, layout, pattern, quality=quality, seed=7)
    for k in (0, 31, 33):
        alone = mitsuba_renderer.render(scene, layout, pattern[k : k + 1], quality=quality, seed=7)
        assert alone.radiance.pattern[0].any()
        assert np.array_equal(stack.radiance.pattern[k], alone.radiance.pattern[0])


@pytest.mark.parametrize("footprint", [False, True])
def test_a_pattern_and_its_inverse_add_up_to_white_and_black_is_dark(mitsuba_renderer, footprint):
    """Oracle: linearity, to the rounding of float32 sums; white is also the sum of its bands."""
    scene, layout = corner_scene()
    code = gray(48, 36, inverses=True)
    quality = Quality(samples=8, depth=DEPTH, footprint=footprint)
    light = mitsuba_renderer.render(scene, layout, code.render(), quality=quality, seed=3).radiance
    white = light.pattern[0]
    assert white.max() > 0.5
    assert not light.pattern[1].any()
    for k in range(2, len(code.frames), 2):
        assert np.abs(light.pattern[k] + light.pattern[k + 1] - white).max() < 1e-5 * white.max()
    assert np.abs(light.white_rgb.sum(axis=-1) - white).max() < 1e-5 * white.max()


def test_a_grey_level_gives_its_share_of_white_even_after_reflections(mitsuba_renderer):
    scene, layout = corner_scene()
    pattern = plain_pattern(scene.rig, 255, 1, 77, 128, 254)
    quality = Quality(samples=4, depth=DEPTH)
    light = mitsuba_renderer.render(scene, layout, pattern, quality=quality, seed=0).radiance
    white = light.pattern[0]
    for image, level in zip(light.pattern, (255, 1, 77, 128, 254), strict=True):
        assert np.abs(image - white * (level / 255)).max() < 1e-5 * white.max()


def test_each_seed_gives_independent_noise_and_zero_is_an_ordinary_seed(mitsuba_renderer):
    scene, layout = corner_scene()
    pattern = plain_pattern(scene.rig, 255)
    quality = Quality(samples=4, depth=DEPTH)
    images = [
        mitsuba_renderer.render(scene, layout, pattern, quality=quality, seed=s).radiance.pattern[0]
        for s in (0, 0, 1, 2**40)
    ]
    assert np.array_equal(images[0], images[1])
    for a, b in [(0, 2), (0, 3), (2, 3)]:
        lit = (images[a] > 0) & (images[b] > 0)
        assert (images[a] != images[b])[lit].mean() > 0.99
        # Means of 200 seeds scatter by 0.0075, so ratios by 0.0106; the limit is five times that.
        assert abs(images[a].mean() / images[b].mean() - 1) < 0.053


def test_the_path_footprint_does_not_change_direct_light(mitsuba_renderer):
    rig = askew_rig()
    flat = in_camera(rig, leaning_wall([0.2, 0.1, 1.0], 0.8, lambert(0.7)))
    stripes = np.zeros((1, 48, 64), dtype=np.uint8)
    stripes[:, :, ::2] = 255
    direct = [
        mitsuba_renderer.render(
            flat,
            EMPTY_LAYOUT,
            stripes,
            quality=Quality(samples=16, depth=1, footprint=footprint),
            seed=4,
        ).radiance.pattern
        for footprint in (False, True)
    ]
    assert np.array_equal(*direct)


@pytest.mark.slow
def test_the_path_footprint_conserves_reflected_light(mitsuba_renderer):
    """Stripes light one wall, which alone lights the other: the footprint blurs the stripes'
    reflection, which must not change its mean.
    """
    scene, layout = corner_scene()
    stripes = np.zeros((1, 36, 48), dtype=np.uint8)
    stripes[:, :, 1::2] = 255
    total = np.empty((2, 6))
    for i, footprint in enumerate((False, True)):
        quality = Quality(samples=36, depth=2, footprint=footprint)
        for seed in range(6):
            image = mitsuba_renderer.render(scene, layout, stripes, quality=quality, seed=seed)
            total[i, seed] = image.radiance.pattern.mean()
    error = np.hypot(*total.std(axis=1, ddof=1)) / np.sqrt(6)
    assert error < 0.003 * total[0].mean()
    assert abs(total[1].mean() - total[0].mean()) < 4 * error
