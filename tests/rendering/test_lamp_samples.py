"""Lamps use every second sample of a pixel: each number of samples must have the same mean."""

import numpy as np
import pytest
from stage import centred, in_camera, lambert, make_rig, plain_pattern, wall

from graycast.rendering import Quality
from graycast.world.scene import EMPTY_LAYOUT, Environment


@pytest.mark.parametrize("depth", [1, 3])
@pytest.mark.parametrize("samples", [1, 2, 3, 5])
def test_a_wall_under_a_uniform_sky_reflects_its_albedo_share(mitsuba_renderer, samples, depth):
    """Oracle: `L = albedo L_sky`; a wrong weight of odd counts is off by a sixth or more."""
    rig = make_rig(centred(64, 48, 80), centred(16, 12, 20))
    scene = in_camera(
        rig, wall(1.0, lambert(0.6), half_m=5.0), environment=Environment(radiance=(2.0, 2.0, 2.0))
    )
    light = mitsuba_renderer.render(
        scene,
        EMPTY_LAYOUT,
        plain_pattern(rig, 255),
        quality=Quality(samples=samples, depth=depth),
        seed=4,
    )
    green = light.radiance.ambient_rgb[..., 1].astype(np.float64)
    error = green.std() / np.sqrt(green.size)
    assert 0 < error < 0.03  # four of them are less than a sixth of the tested value
    assert abs(green.mean() - 0.6 * 2.0) < 4 * error
