"""Highlights, compared with the microfacet model with camera, projector and normal on one line."""

import numpy as np
import pytest
from stage import centred, in_camera, make_rig, plain_pattern, wall

from graycast.rendering import Quality
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT


@pytest.mark.parametrize("roughness", [0.3, 0.5])
@pytest.mark.parametrize(
    ("metallic", "reflectance"), [(1.0, (1.0, 1.0, 1.0)), (0.0, (0.04, 0.04, 0.04))]
)
def test_a_highlight_seen_along_the_normal_has_the_radiance_of_ggx(
    mitsuba_renderer, roughness, metallic, reflectance
):
    """f = F D / 4 with D = 1 / (pi alpha^2) and alpha = roughness^2 (Walter et al. 2007), so the
    radiance is F I / (4 pi alpha^2 d^2). The lenses are 2 mm apart at 1 m: half vectors lean by
    1e-3, which lowers D by (1e-3 / alpha)^2. White metal returns in the same directions what one
    reflection loses, so its highlight is higher by one over the share E that it keeps.
    """
    base = reflectance if metallic else (0.0, 0.0, 0.0)
    material = Material(base_color=base, metallic=metallic, roughness=roughness)
    rig = make_rig(
        centred(8, 8, 4000),
        centred(8, 8, 8),
        baseline_m=(0.002, 0.0, 0.0),
        intensity_w_sr=3.0,
        band_weights=(0.5, 0.25, 0.25),
    )
    light = mitsuba_renderer.render(
        in_camera(rig, wall(1.0, material)),
        EMPTY_LAYOUT,
        plain_pattern(rig, 255),
        quality=Quality(samples=16, depth=1),
        seed=0,
    ).radiance.white_rgb
    expected = np.array(reflectance) * 3.0 / (4 * np.pi * roughness**4) * [0.5, 0.25, 0.25]
    if metallic:
        expected /= directional_albedo(roughness**2)
    assert np.abs(light.mean(axis=(0, 1)) / expected - 1).max() < 0.005


def directional_albedo(alpha):
    """Return E along the normal: the integral of D G cos over facets, which reflect to twice their
    slope; G is Smith's masking at that angle.
    """
    lean = np.pi / 4 * (np.arange(100_000) + 0.5) / 100_000
    d = alpha**2 / np.pi / np.cos(lean) ** 4 / (alpha**2 + np.tan(lean) ** 2) ** 2
    g = 2 / (1 + np.sqrt(1 + (alpha * np.tan(2 * lean)) ** 2))
    return (d * g * np.cos(lean) * 2 * np.pi * np.sin(lean)).mean() * np.pi / 4
