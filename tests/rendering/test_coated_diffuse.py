"""The coated material: reciprocity, a normalised density, and conservation of energy."""

import numpy as np
import pytest
from stage import centred, in_camera, make_rig, plain_pattern, wall

from graycast.rendering import Quality
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Sphere

ALPHAS = [0.01, 0.09, 0.49, 1.0]


def coated(alpha, base):
    import mitsuba as mi

    import graycast.rendering.mitsuba.scene  # noqa: F401  (registers the material)

    color = {"type": "rgb", "value": base}
    return mi.load_dict(
        {"type": "coated_diffuse", "alpha": alpha, "eta": 1.5, "reflectance": color}
    )


def incidence(cosine, n):
    import drjit as dr
    import mitsuba as mi

    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.t = 1.0
    si.wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, cosine)
    return si


def hemisphere(n, seed):
    """Return uniform directions of density 1 / (2 pi)."""
    rng = np.random.default_rng(seed)
    z, turn = rng.random(n), 2 * np.pi * rng.random(n)
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z])


@pytest.mark.parametrize("alpha", ALPHAS)
def test_the_coated_material_is_reciprocal(cpu_device, alpha):
    """Helmholtz: f(wi, wo) = f(wo, wi) for every pair."""
    import mitsuba as mi

    bsdf, context = coated(alpha, 0.7), mi.BSDFContext()
    a, b = hemisphere(2000, 0).astype(np.float32), hemisphere(2000, 1).astype(np.float32)
    si = incidence(1.0, 2000)
    values = []
    for wi, wo in ((a, b), (b, a)):
        si.wi = mi.Vector3f(wi)
        values.append(np.array(bsdf.eval(context, si, mi.Vector3f(wo), True))[0] / wo[2])
    sure = (a[2] > 0.05) & (b[2] > 0.05)
    assert np.abs(values[0] / values[1] - 1)[sure].max() < 1e-3


@pytest.mark.parametrize("alpha", [0.09, 0.49, 1.0])
def test_the_lobe_of_a_coat_over_black_has_the_published_shape(cpu_device, alpha):
    """Oracle: F D G2 / (4 cos cos), D by the tangent (Walter), G2 by Lambda (Heitz), F by Snell."""
    import mitsuba as mi

    n = 2000
    wi, wo = hemisphere(n, 5), hemisphere(n, 6)
    sure = (wi[2] > 0.05) & (wo[2] > 0.05)
    si = incidence(1.0, n)
    si.wi = mi.Vector3f(wi.astype(np.float32))
    towards = mi.Vector3f(wo.astype(np.float32))
    value = np.array(coated(alpha, 0.0).eval(mi.BSDFContext(), si, towards, True))[0] / wo[2]
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=0)
    d = alpha**2 / np.pi / half[2] ** 4 / (alpha**2 + 1 / half[2] ** 2 - 1) ** 2
    hidden = [0.5 * (np.sqrt(1 + alpha**2 * (1 / w[2] ** 2 - 1)) - 1) for w in (wi, wo)]
    outer = np.arccos((wi * half).sum(axis=0))
    inner = np.arcsin(np.sin(outer) / 1.5)
    across = np.sin(outer - inner) / np.sin(outer + inner)
    along = np.tan(outer - inner) / np.tan(outer + inner)
    expected = 0.5 * (across**2 + along**2) * d / (1 + sum(hidden)) / (4 * wi[2] * wo[2])
    assert np.abs(value / expected - 1)[sure].max() < 2e-3


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cosine", [0.98, 0.6, 0.2])
def test_samples_of_the_coated_material_agree_with_its_density_and_value(cpu_device, alpha, cosine):
    """The mean weight of samples is the integral of the value, and the mean of 1 over their density
    is the solid angle of a cap that they can reach.
    """
    import mitsuba as mi

    n = 200_000
    bsdf, context, si = coated(alpha, 0.5), mi.BSDFContext(), incidence(cosine, n)
    rng = np.random.default_rng(3)
    one = mi.Float(rng.random(n).astype(np.float32))
    two = mi.Point2f(rng.random((2, n)).astype(np.float32))
    sample, weight = bsdf.sample(context, si, one, two, True)
    weight = np.array(weight)[0]
    lost = weight == 0  # half vectors that mirror below the surface
    albedo, error = weight.mean(), weight.std() / np.sqrt(n)
    wo, pdf = np.array(sample.wo), np.array(sample.pdf)
    cap = (wo[2] > 0.3) & (wo[2] < 0.7) & ~lost
    inverse = np.where(cap, 1 / np.maximum(pdf, 1e-9), 0)
    assert abs(inverse.mean() - 2 * np.pi * 0.4) < 5 * inverse.std() / np.sqrt(n)
    if alpha > 0.05:  # otherwise uniform directions miss the lobe
        wo = hemisphere(n, 4)
        value = (
            np.array(bsdf.eval(context, si, mi.Vector3f(wo.astype(np.float32)), True))[0]
            * 2
            * np.pi
        )
        assert abs(value.mean() - albedo) < 5 * np.hypot(error, value.std() / np.sqrt(n))


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_a_coat_over_a_white_base_absorbs_no_light(mitsuba_renderer, roughness):
    """Furnace: E + base (1 - E) is 1 for a white base, and linear in the base for any other."""
    rig = make_rig(centred(24, 24, 40), centred(8, 8, 8))
    sky = Environment(radiance=(1.0, 1.0, 1.0))
    material = Material(base_color=(1.0, 0.5, 0.0), roughness=roughness)
    ball = Sphere(center_m=(0.0, 0.0, 1.0), radius_m=0.5, material=material)
    quality = Quality(samples=64, depth=3)
    light = mitsuba_renderer.render(
        in_camera(rig, ball, environment=sky),
        EMPTY_LAYOUT,
        plain_pattern(rig, 0),
        quality=quality,
        seed=1,
    )
    ball_rgb = light.radiance.ambient_rgb[np.isfinite(light.truth.depth_m)].astype(float)
    error = ball_rgb.std(axis=0) / np.sqrt(len(ball_rgb))
    white, half, black = ball_rgb.mean(axis=0)
    assert abs(white - 1) < 4 * error[0] + 0.002  # 64 nodes of the table
    assert abs(half - 0.5 * (white + black)) < 4 * error[1] + 0.002
    assert 0.01 < black < 0.2


def test_a_smooth_coat_over_black_has_fresnel_s_reflectance_at_60_degrees(mitsuba_renderer):
    """At 60 degrees an index of 1.5 reflects 8.9 % (Fresnel, by hand)."""
    import mitsuba as mi

    si = incidence(0.5, 200_000)
    rng = np.random.default_rng(0)
    one = mi.Float(rng.random(200_000).astype(np.float32))
    two = mi.Point2f(rng.random((2, 200_000)).astype(np.float32))
    weight = coated(0.01, 0.0).sample(mi.BSDFContext(), si, one, two, True)[1]
    inner = np.sqrt(1 - 0.75 / 2.25)  # cosine within, by Snell
    along = (0.75 - inner) / (0.75 + inner)
    across = (0.5 - 1.5 * inner) / (0.5 + 1.5 * inner)
    expected = 0.5 * (along**2 + across**2)
    assert abs(expected - 0.0892) < 1e-4
    assert abs(np.array(weight)[0].mean() / expected - 1) < 0.01


def test_a_coat_does_not_darken_a_white_wall(mitsuba_renderer):
    """A white wall in white light at normal incidence gives 1 with and without the coat."""
    rig = make_rig(centred(16, 16, 100), centred(8, 8, 8))
    sky = Environment(radiance=(1.0, 1.0, 1.0))
    for specular in (0.0, 0.5, 1.0):
        material = Material(base_color=(1.0, 1.0, 1.0), roughness=0.5, specular=specular)
        scene = in_camera(rig, wall(1.0, material, half_m=50.0), environment=sky)
        quality = Quality(samples=64, depth=2)
        light = mitsuba_renderer.render(
            scene, EMPTY_LAYOUT, plain_pattern(rig, 0), quality=quality, seed=0
        ).radiance.ambient_rgb
        assert abs(light.mean() - 1) < 0.01
