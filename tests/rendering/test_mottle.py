"""Mottled surfaces: spread, length and mean as stated, a pattern on the part itself, checks."""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from stage import (
    box_part,
    centred,
    in_camera,
    lambert,
    layout_in_camera,
    make_rig,
    plain_pattern,
    wall,
)

from graycast.base.errors import ConfigError
from graycast.base.frames import axis_rotation, rigid
from graycast.cell.domain.looks import retouched
from graycast.cell.domain.vary import _retouched_part
from graycast.rendering import Quality
from graycast.rendering.wavelength import refuse_layers
from graycast.world.parts import Material
from graycast.world.parts.material_section import MaterialSection, resolve_material
from graycast.world.parts.part import MOTTLE_PEAK
from graycast.world.scene import EMPTY_LAYOUT, Sphere

PIXEL_M = 0.0005  # at 1 m
RIG = make_rig(centred(240, 180, 1 / PIXEL_M), centred(8, 8, 10), baseline_m=(0.01, 0.0, 0.0))
PLAIN = lambert(0.5, 0.4, 0.3)


def mottled(length_px, spread=0.2, plain=PLAIN):
    return replace(plain, mottle=spread, mottle_length_m=length_px * PIXEL_M)


def lit(renderer, scene, layout=EMPTY_LAYOUT, *, seed=0):
    """Return the light of the projector, which is without noise."""
    pattern = plain_pattern(RIG, 255)
    quality = Quality(samples=8, depth=1)
    rendering = renderer.render(scene, layout, pattern, quality=quality, seed=seed)
    return rendering.radiance.white_rgb


def plate(material):
    return in_camera(RIG, wall(1.0, material, half_m=0.4))


def correlation(picture):
    """Return the correlation of a picture with itself, by distances in rows and columns."""
    size = [(0, n) for n in picture.shape]
    one, own = (
        np.fft.ifft2(np.abs(np.fft.fft2(np.pad(a, size))) ** 2).real
        for a in (np.ones_like(picture), picture)
    )
    product = own / np.maximum(one, 0.5)
    return product / product[0, 0]


@pytest.mark.parametrize(("length_px", "spread"), [(4.0, 0.2), slow(8.0, 0.1)])
def test_mottle_has_the_stated_spread_and_length_and_keeps_the_mean(
    mitsuba_renderer, length_px, spread
):
    """Oracle: the law `1 + spread u` with the correlation `exp(-(r / length)^2)`.

    The plate has `pixels / (pi length^2 / 2)` independent places, so the deviation of a uniform
    distribution has the error sqrt(0.2 / places), and the mean that of places twice as large. A
    pixel averages `1 - 1 / (6 length^2)` of the deviation away along each axis.
    """
    plain, varied = (
        lit(mitsuba_renderer, plate(material)) for material in (PLAIN, mottled(length_px, spread))
    )
    ratio = varied / plain
    assert np.abs(ratio - ratio[..., :1]).max() < 1e-4  # all bands have one factor
    picture = ratio[..., 0]
    places = picture.size / (np.pi * length_px**2 / 2)
    within_pixels = 1 - 2 / (12 * length_px**2)
    assert abs(picture.mean() - 1) < 3 * spread * np.sqrt(2 / places)
    assert abs(picture.std() / (spread * within_pixels) - 1) < 3 * np.sqrt(0.2 / places)
    measured = correlation(picture - picture.mean())
    for distance_px in (length_px / 2, length_px, 3 * length_px):
        law = np.exp(-((distance_px / length_px) ** 2))
        for value in (measured[int(distance_px), 0], measured[0, int(distance_px)]):
            assert abs(value - law) < 3 / np.sqrt(places) + 0.01, distance_px


def test_the_mottle_pattern_does_not_depend_on_the_seed(mitsuba_renderer):
    one, again, other = (
        lit(mitsuba_renderer, plate(mottled(6.0)), seed=seed)[..., 0] for seed in (1, 1, 2)
    )
    assert np.array_equal(one, again)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.98


def test_the_mottle_pattern_moves_with_its_part_and_differs_between_copies(mitsuba_renderer):
    """Half a turn about the camera's axis turns the picture; two copies have no correlation."""
    part = box_part(np.array([0.025, 0.025, 0.01]), mottled(6.0))
    away = np.array([0.0, 0.0, 1.0])

    def picture(*poses):
        scene = in_camera(RIG, parts=(part,))
        layout = layout_in_camera([0] * len(poses), poses)
        return lit(mitsuba_renderer, scene, layout)[..., 0]

    upright = picture(rigid(np.eye(3), away))
    turned = picture(rigid(axis_rotation("z", np.pi), away))
    inside = np.s_[60:120, 90:150]
    both = upright[inside].ravel(), turned[::-1, ::-1][inside].ravel()
    assert np.corrcoef(*both)[0, 1] > 0.98
    aside = np.array([0.03, 0.0, 0.0])
    pair = picture(rigid(np.eye(3), away - aside), rigid(np.eye(3), away + aside))
    copies = pair[60:120, 40:80].ravel(), pair[60:120, 160:200].ravel()
    assert min(copy.min() for copy in copies) > 0
    assert abs(np.corrcoef(*copies)[0, 1]) < 0.4  # 40 independent places


def test_mottle_deviates_from_the_mean_by_at_most_the_stated_peak(cpu_device):
    from graycast.rendering.bsdf.mottle import mottle_field

    field = mottle_field()
    assert abs(field.mean()) < 1e-6 and abs(field.std() - 1) < 0.05
    assert 0.98 * MOTTLE_PEAK < np.abs(field).max() < MOTTLE_PEAK
    white = Material(base_color=(0.7,) * 3, mottle=0.2)
    assert max(white.base_color) * (1 + white.mottle * np.abs(field).max()) < 1


def test_a_surface_without_mottle_has_no_mottle_in_its_mitsuba_description(cpu_device):
    """So the pictures of all other materials stay the same."""
    from graycast.rendering.mitsuba.scene import _bsdf, _flat_surface
    from graycast.world.scene import Quad

    for material in (PLAIN, Material(metallic=1.0), Material(metallic=1.0, film=0.05)):
        assert "mottled" not in str(_bsdf(material)) and "mottle" not in material.words
    quad = Quad(center_m=(0, 0, 0), half_u_m=(1, 0, 0), half_v_m=(0, 1, 0), material=PLAIN)
    assert _flat_surface("table", quad)["type"] == "rectangle"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"base_color": (0.9, 0.9, 0.9)}, "base_color is 0.9 .* lower base_color to 0.735, or"),
        ({"projector_reflectance": 0.8}, "projector_reflectance is 0.8 .* to 0.735"),
        ({"texture": np.zeros((2, 2, 3), np.uint8)}, "has a texture: remove one"),
        ({"transparent": "thin"}, "is transparent: remove one"),
        ({"mottle": 0.6}, "mottle"),
        ({"mottle_length_m": 0.0}, "mottle_length_m"),
    ],
)
def test_impossible_mottle_is_refused(words, message):
    with pytest.raises(ValueError, match=message):
        Material(**({"mottle": 0.2} | words))


def test_mottle_keys_are_applied_and_a_length_without_mottle_is_refused(tmp_path):
    section = MaterialSection(mottle=0.1, mottle_length_m=0.0005)
    material = resolve_material(section, tmp_path)
    assert (material.mottle, material.mottle_length_m) == (0.1, 0.0005)
    assert material.words["mottle"] == 0.1 and material.words["mottle_length_m"] == 0.0005
    with pytest.raises(ConfigError, match="mottle_length_m belongs to mottle"):
        resolve_material(MaterialSection(mottle_length_m=0.0005), tmp_path)


def test_only_meshes_rendered_by_mitsuba_can_be_mottled():
    with pytest.raises(ValueError, match="only meshes can have it"):
        Sphere(center_m=(0.0, 0.0, 0.0), radius_m=1.0, material=mottled(6.0))
    with pytest.raises(ValueError, match="Cycles cannot render mottled surfaces: use mitsuba"):
        refuse_layers(plate(mottled(6.0)), "Cycles")


def test_a_brightened_mottled_part_stays_below_the_limit_of_its_mottle():
    material = replace(mottled(6.0), projector_reflectance=0.5)
    brighter = retouched(material, brightness=3.0, roughness=0.0)
    limit = 1 / (1 + MOTTLE_PEAK * 0.2)
    assert max(brighter.base_color) == brighter.projector_reflectance == limit


def test_a_random_colour_for_a_mottled_part_is_below_the_limit_of_its_mottle():
    part = box_part(np.array([0.02, 0.02, 0.02]), mottled(6.0))
    white = {"hue_deg": 0.0, "saturation": 0.0, "value": 1.0}
    values = {"color": white, "roughness": 0.0, "metallic": 0.0}
    limit = 1 / (1 + MOTTLE_PEAK * 0.2)
    assert _retouched_part(part, values).material.base_color == (limit,) * 3
