"""Light that materials reflect, compared with conservation of energy and Fresnel."""

import numpy as np
import pytest
from stage import centred, in_camera, make_rig, plain_pattern, wall

from graycast.rendering import Quality
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Sphere

WHITE = Environment(radiance=(1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    "words",
    [
        {"metallic": 1.0, "roughness": 0.2},
        {"metallic": 1.0, "roughness": 0.9},
        {"roughness": 0.3},
        {"metallic": 0.5, "roughness": 0.3},
    ],
)
def test_a_white_body_reflects_exactly_all_light(mitsuba_renderer, words):
    """A convex body in a furnace reflects light once; the tables of metal and coat allow 0.2 %."""
    material = Material(base_color=(1.0, 1.0, 1.0), **words)
    rig = make_rig(centred(24, 24, 40), centred(8, 8, 8))
    ball = Sphere(center_m=(0.0, 0.0, 1.0), radius_m=0.5, material=material)
    scene = in_camera(rig, ball, environment=WHITE)
    quality = Quality(samples=64, depth=4)
    light = mitsuba_renderer.render(
        scene, EMPTY_LAYOUT, plain_pattern(rig, 0), quality=quality, seed=1
    )
    ball_light = light.radiance.ambient_rgb[np.isfinite(light.truth.depth_m)][:, 0]
    error = ball_light.std() / np.sqrt(len(ball_light))
    assert error < 0.004
    assert abs(ball_light.mean() - 1) < 0.002 + 3 * error


@pytest.mark.parametrize("specular", [0.5, 1.0])
def test_a_coat_over_black_reflects_exactly_its_normal_reflectance(mitsuba_renderer, specular):
    """0.08 * specular at normal incidence: 0.04 for the index 1.5 of most plastics (Fresnel)."""
    rig = make_rig(centred(16, 16, 200), centred(8, 8, 8))
    material = Material(base_color=(0.0, 0.0, 0.0), roughness=0.1, specular=specular)
    scene = in_camera(rig, wall(1.0, material), environment=WHITE)
    quality = Quality(samples=64, depth=2)
    light = mitsuba_renderer.render(
        scene, EMPTY_LAYOUT, plain_pattern(rig, 0), quality=quality, seed=0
    ).radiance.ambient_rgb
    assert abs(light.mean() / (0.08 * specular) - 1) < 0.01


def test_a_metal_reflects_its_base_colour_at_normal_incidence(mitsuba_renderer):
    rig = make_rig(centred(16, 16, 200), centred(8, 8, 8))
    base = (0.9, 0.6, 0.3)
    material = Material(base_color=base, metallic=1.0, roughness=0.1)
    scene = in_camera(rig, wall(1.0, material), environment=WHITE)
    quality = Quality(samples=64, depth=2)
    image = mitsuba_renderer.render(
        scene, EMPTY_LAYOUT, plain_pattern(rig, 0), quality=quality, seed=0
    ).radiance
    assert np.abs(image.ambient_rgb.mean(axis=(0, 1)) / base - 1).max() < 0.01
    assert np.abs(image.albedo - base).max() < 1e-4
