"""Static speckle: its contrast, what it does to positions, and when it is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stage import centred, in_camera, lambert, make_rig, plain_pattern, wall

from graycast.render import Quality
from graycast.scene import EMPTY_LAYOUT, Environment

SAMPLES = 16


def scene(contrast, **words):
    rig = make_rig(centred(64, 48, 160), centred(560, 420, 1280), baseline_m=(5e-3, 0.0, 0.0))
    return in_camera(replace(rig, speckle_contrast=contrast), wall(0.9, lambert(0.7)), **words)


def light_of(renderer, scene, pattern, *, samples=SAMPLES):
    quality = Quality(samples=samples, depth=1)
    return renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=0).radiance


@pytest.mark.parametrize("contrast", [0.05, 0.2])
def test_a_flat_wall_has_the_contrast_of_the_rig_and_its_mean_light(mitsuba_renderer, contrast):
    """Standard deviation over mean of n pixels is known to C / sqrt(2 n), the mean to C / sqrt(n);
    the sum of 16 exponentials is wider than a normal one: its kurtosis adds 3 / 16 of that.
    """
    clean, rough = (
        light_of(mitsuba_renderer, scene(c), plain_pattern(scene(c).rig, 255)).white
        for c in (0.0, contrast)
    )
    share = (rough / clean)[clean > 0].astype(float)
    n = share.size
    assert n > 2900
    assert share.std() == pytest.approx(contrast, rel=4 * math.sqrt((1 + 3 / 16 + 0.1) / (2 * n)))
    assert share.mean() == pytest.approx(1, abs=4 * contrast / math.sqrt(n))


def test_all_frames_share_it_and_other_light_has_none(mitsuba_renderer):
    sky = Environment(radiance=(0.5, 0.5, 0.5))
    lit = scene(0.2, environment=sky)
    light = light_of(mitsuba_renderer, lit, plain_pattern(lit.rig, 255, 128, 51))
    assert np.abs(light.pattern[0] - light.white).max() < 1e-5 * light.white.max()
    assert np.abs(light.pattern[1] - light.white * (128 / 255)).max() < 1e-5 * light.white.max()
    assert np.abs(light.pattern[2] - light.white * 0.2).max() < 1e-5 * light.white.max()
    still = light_of(mitsuba_renderer, scene(0.0, environment=sky), plain_pattern(lit.rig, 255))
    # Its own Monte Carlo noise, but no more.
    assert light.ambient.std() == pytest.approx(still.ambient.std(), rel=0.06)
    assert light.ambient.mean() == pytest.approx(still.ambient.mean(), rel=0.03)


@pytest.mark.parametrize("contrast", [0.05, 0.15])
def test_it_moves_each_pixels_centre_of_light_although_all_frames_share_it(
    mitsuba_renderer, contrast
):
    """Weights of contrast C sqrt(n) on n places all over a pixel move their centre by C / sqrt(12)
    of it (the argument of Dorsch, Haeusler & Herrmann, Applied Optics 33, 1994).
    """
    lit = scene(contrast)
    h, w = lit.rig.projector.height_px, lit.rig.projector.width_px
    ramp = np.broadcast_to((np.arange(w) // 3).astype(np.uint8), (1, h, w))
    place = []
    for one in (lit, scene(0.0)):
        light = light_of(mitsuba_renderer, one, ramp)
        place.append(light.pattern[0] / light.white * 255 * 3 / 8)  # camera pixels
    moved = (place[0] - place[1])[4:-4, 4:-4]
    assert moved.std() == pytest.approx(contrast / math.sqrt(12), rel=0.06)
    assert abs(moved.mean()) < 4 * moved.std() / math.sqrt(moved.size)


def test_more_samples_than_speckles_are_refused(mitsuba_renderer):
    lit = scene(0.3)
    with pytest.raises(ValueError, match="use 11 samples or fewer"):
        light_of(mitsuba_renderer, lit, plain_pattern(lit.rig, 255), samples=12)
    light_of(mitsuba_renderer, lit, plain_pattern(lit.rig, 255), samples=11)
