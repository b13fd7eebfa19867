"""The light that a material reflects between two directions, against closed forms."""

import numpy as np
import pytest

from graycast.world.parts import Material

STEEP = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.8, 0.6]])


@pytest.fixture
def reflected_share(cpu_device):
    from graycast.rendering.mitsuba.lobe import reflected_share

    return reflected_share


def test_a_diffuser_reflects_by_lambert_s_law(reflected_share):
    """Oracle: Lambert's law. The cosine to the camera would give other numbers."""
    matt = Material(base_color=(0.6,) * 3, specular=0.0)
    share = reflected_share(matt, STEEP[::-1], STEEP)
    assert np.allclose(share, 0.6 / np.pi * STEEP[:, 2], rtol=1e-5)


@pytest.mark.parametrize("roughness", [0.2, 0.3])
def test_the_peak_of_a_smooth_metal_has_the_height_from_the_ggx_formula(reflected_share, roughness):
    """Oracle: GGX at the normal, D = 1 / (pi alpha^2), f = F D / 4; facets lose less than 1 %."""
    metal = Material(base_color=(0.7,) * 3, metallic=1.0, roughness=roughness)
    up = np.array([[0.0, 0.0, 1.0]])
    peak = 0.7 / (4 * np.pi * roughness**4)
    assert reflected_share(metal, up, up) == pytest.approx([peak], rel=0.01)
