"""Colours of surfaces and lamps from drawn values."""

import numpy as np
import pytest

from graycast.base.color import linear, srgb
from graycast.cell.domain.looks import color_of, light_of, retouched
from graycast.world.parts import Material


@pytest.mark.parametrize(
    ("hue_deg", "saturation", "value", "encoded"),
    [
        (0.0, 1.0, 1.0, (255, 0, 0)),
        (120.0, 1.0, 0.5, (0, 128, 0)),
        (200.0, 0.0, 0.4, (102, 102, 102)),
        (60.0, 0.5, 1.0, (255, 255, 128)),
    ],
)
def test_a_drawn_hsv_colour_equals_that_in_a_colour_picker(hue_deg, saturation, value, encoded):
    color = {"hue_deg": hue_deg, "saturation": saturation, "value": value}
    assert srgb(np.array(color_of(color))).tolist() == list(encoded)


def test_a_brightness_factor_multiplies_linear_texture_values_up_to_1():
    picture = np.random.default_rng(0).integers(0, 256, (32, 32, 3), dtype=np.uint8)
    brighter = retouched(
        Material(texture=picture), brightness=1.5, roughness=0.0, tint=(1.0, 0.5, 2.0)
    )
    expected = np.minimum(linear(picture) * [1.5, 0.75, 3.0], 1)
    assert (srgb(expected) == brighter.texture).all()
    assert (brighter.texture[..., 2] == 255).mean() > 0.3
    same = retouched(Material(texture=picture), brightness=1.0, roughness=0.0)
    assert (same.texture == picture).all()


def test_plain_parts_are_brightened_up_to_white_and_roughened_up_to_matt():
    steel = Material(base_color=(0.2, 0.5, 0.8), metallic=1.0, roughness=0.9)
    steel = retouched(steel, brightness=2.0, roughness=0.3, metallic=-0.4)
    assert steel.base_color == pytest.approx((0.4, 1.0, 1.0))
    assert (steel.roughness, steel.metallic) == (1.0, 0.6)
    smooth = retouched(Material(roughness=0.1), brightness=1.0, roughness=-0.2, metallic=-0.2)
    assert (smooth.roughness, smooth.metallic) == (0.05, 0.0)
    polished = Material(roughness=0.02)
    for change in (0.0, -0.2):
        assert retouched(polished, brightness=1.0, roughness=change).roughness == 0.02


def test_the_reflectance_for_the_projector_follows_brightness_but_not_tint():
    red = Material(projector_reflectance=0.4)
    tinted = retouched(red, brightness=1.5, roughness=0.0, tint=(0.1, 0.1, 0.1))
    assert tinted.projector_reflectance == pytest.approx(0.6)
    assert retouched(Material(), brightness=1.5, roughness=0.0).projector_reflectance is None


def planck(wavelength_nm, temperature_k):
    """Return the spectral radiance of a black body; radiation constant c2 = 14387769 nm K."""
    return wavelength_nm**-5 / np.expm1(14387768.8 / (wavelength_nm * temperature_k))


def observer(wavelength_nm):
    """Return the CIE 1931 observer as Gaussians of C. Wyman et al., JCGT 2 (2), 2013."""

    def bump(middle, below, above):
        t = (wavelength_nm - middle) * np.where(wavelength_nm < middle, below, above)
        return np.exp(-0.5 * t * t)

    x = 0.362 * bump(442.0, 0.0624, 0.0374) + 1.056 * bump(599.8, 0.0264, 0.0323)
    x -= 0.065 * bump(501.1, 0.0490, 0.0382)
    y = 0.821 * bump(568.8, 0.0213, 0.0247) + 0.286 * bump(530.9, 0.0613, 0.0322)
    z = 1.217 * bump(437.0, 0.0845, 0.0278) + 0.681 * bump(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z])


@pytest.mark.parametrize("temperature_k", [2000.0, 2700.0, 4000.0, 4001.0, 6500.0, 15000.0])
def test_the_colour_of_a_temperature_follows_planck_s_law_and_the_cie_observer(temperature_k):
    """The Gaussians and the cubic fit differ by one or two hundredths."""
    wavelength = np.arange(380.0, 781.0)
    xyz = observer(wavelength) @ planck(wavelength, temperature_k)
    primaries = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
    XYZ = np.stack([primaries[:, 0], primaries[:, 1], 1 - primaries.sum(axis=1)])
    white = np.array([0.3127, 0.3290, 0.3583]) / 0.3290
    rgb = np.linalg.solve(XYZ * np.linalg.solve(XYZ, white), xyz)  # the matrix, from its definition
    rgb = np.maximum(rgb, 0) / np.maximum(rgb, 0).mean()
    assert light_of(temperature_k) == pytest.approx(tuple(rgb), abs=0.03)
    assert np.mean(light_of(temperature_k)) == pytest.approx(1)
