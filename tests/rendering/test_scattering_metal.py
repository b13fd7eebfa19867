"""Metal that scatters a share of its light: energy, a closed form of the mix, samples, checks."""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from bsdf_samples import (
    assert_samples_fall_where_densities_say,
    evaluated,
    leaning,
    samples_of,
    upper,
)

from graycast.cell.domain.looks import retouched
from graycast.world.parts import Grain, Material

GOLD = (1.0, 0.7, 0.3)
METAL = Material(base_color=GOLD, metallic=1.0, roughness=0.4)
BRUSHED = replace(METAL, anisotropy=0.8, grain=Grain(axis=(1.0, 0.0, 0.0)))


def bsdf_of(material):
    import mitsuba as mi

    from graycast.rendering.mitsuba.scene import _bsdf

    return mi.load_dict(_bsdf(material))


@pytest.mark.parametrize("roughness", [0.1, slow(0.4), 0.8])
@pytest.mark.parametrize("diffuse", [0.3, slow(1.0)])
def test_white_scattering_metal_absorbs_no_light(cpu_device, roughness, diffuse):
    """The limit is that of plain metal."""
    white = Material(base_color=(1.0,) * 3, metallic=1.0, roughness=roughness, diffuse=diffuse)
    for angle_deg in (0, 60, 85):
        weight = samples_of(bsdf_of(white), leaning(angle_deg), 200_000)[2][0]
        error = weight.std() / np.sqrt(weight.size)
        assert abs(weight.mean() - 1) < 0.002 + 4 * error, angle_deg


def test_scattering_metal_mixes_a_lambert_share_with_plain_metal(cpu_device):
    """Oracle: `diffuse` times base_color / pi, and 1 - `diffuse` times the metal without the key,
    for metal alone and as a share of a half metallic surface.
    """
    wo = upper(500, 3)
    for angle_deg in (0, 50, 80):
        wi = leaning(angle_deg)
        lambert = np.array(GOLD)[:, None] / np.pi
        plain, mixed = (
            evaluated(bsdf_of(replace(METAL, diffuse=share)), wi, wo)[0] for share in (0.0, 0.3)
        )
        np.testing.assert_allclose(mixed, 0.3 * lambert + 0.7 * plain, rtol=1e-4, atol=1e-6)
        half = replace(METAL, metallic=0.5)
        plastic = evaluated(bsdf_of(replace(METAL, metallic=0.0)), wi, wo)[0]
        mixed_half = evaluated(bsdf_of(replace(half, diffuse=0.3)), wi, wo)[0]
        np.testing.assert_allclose(mixed_half, (plastic + mixed) / 2, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("angle_deg", [30, slow(70)])
def test_samples_of_scattering_metal_follow_their_density(cpu_device, angle_deg):
    bsdf, wi = bsdf_of(replace(METAL, diffuse=0.4)), leaning(angle_deg)
    assert_samples_fall_where_densities_say(bsdf, wi, fine=800)
    wo, density, weight = samples_of(bsdf, wi, 20_000)
    above = weight[0] > 0
    value, again = evaluated(bsdf, wi, wo[:, above])
    assert np.abs(density[above] / again - 1).max() < 1e-3
    assert np.abs(value * wo[2, above] / again / weight[:, above] - 1).max() < 1e-3


@pytest.mark.parametrize("material", [METAL, BRUSHED, replace(METAL, film=0.05)])
def test_materials_without_a_diffuse_share_get_no_mixture_in_mitsuba(cpu_device, material):
    """So pictures of all other materials stay the same: only a share above 0 makes a mix."""
    from graycast.rendering.mitsuba.scene import _bsdf

    assert "blendbsdf" not in str(_bsdf(material)) and "diffuse" not in str(_bsdf(material))
    assert "diffuse" not in material.words


def test_metal_that_scatters_most_light_does_not_count_as_shiny(cpu_device):
    from graycast.rendering.mitsuba.scene import _is_shiny

    smooth = replace(METAL, roughness=0.5, specular=0.0)
    assert _is_shiny(smooth) and _is_shiny(replace(smooth, diffuse=0.3))
    assert not _is_shiny(replace(smooth, diffuse=0.8))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"metallic": 0.0, "diffuse": 0.3}, "set metallic above 0, or remove diffuse"),
        ({"metallic": 1.0, "diffuse": 0.3, "film": 0.05}, "a film has diffuse: remove one"),
        ({"metallic": 1.0, "diffuse": 1.3}, "diffuse"),
    ],
)
def test_a_scattered_share_without_metal_or_under_a_film_is_refused(words, message):
    with pytest.raises(ValueError, match=message):
        Material(**words)


def test_varying_the_look_keeps_the_scattered_share_only_on_metal():
    blasted = replace(METAL, diffuse=0.3)
    less = retouched(blasted, brightness=1.0, roughness=0.0, metallic=-0.5)
    none = retouched(blasted, brightness=1.0, roughness=0.0, metallic=-1.0)
    assert (less.diffuse, none.diffuse) == (0.3, 0.0)
    assert blasted.words["diffuse"] == 0.3
