"""The metal: conservation of energy, the value by another formula, density and samples."""

import numpy as np
import pytest
from backends import slow
from bsdf_samples import (
    arriving,
    assert_samples_fall_where_densities_say,
    direction,
    evaluated,
    leaning,
    samples_of,
    upper,
)

from graycast.world.parts import Material

ROUGHNESS = [0.05, 0.1, 0.3, 0.5, 0.8, 1.0]
GOLD = (1.0, 0.7, 0.3)


def metal(roughness, reflectance=GOLD):
    import mitsuba as mi

    import graycast.rendering.mitsuba.scene  # noqa: F401  (registers the material)

    color = {"type": "rgb", "value": list(reflectance)}
    return mi.load_dict({"type": "rough_conductor", "alpha": roughness**2, "reflectance": color})


def first_reflection(wi, wo, alpha):
    """Return D G2 / (4 cos cos) by Walter's D of the tangent and Heitz' Lambda (columns)."""
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=0)
    tangent2 = 1 / half[2] ** 2 - 1
    d = alpha**2 / (np.pi * half[2] ** 4 * (alpha**2 + tangent2) ** 2)
    hidden = [0.5 * (np.sqrt(1 + alpha**2 * (1 / w[2] ** 2 - 1)) - 1) for w in (wi, wo)]
    return d / (1 + hidden[0] + hidden[1]) / (4 * wi[2] * wo[2]), (wi * half).sum(axis=0)


def directional_albedo(cosine, alpha):
    """Return E by brute force: the first reflection summed over a fine grid of directions."""
    z, turn = (np.arange(400) + 0.5) / 400, np.pi * (np.arange(400) + 0.5) / 400
    wo = np.stack(np.broadcast_arrays(*direction(z[:, None], turn[None]))).reshape(3, -1)
    wi = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])[:, None]
    return 2 * np.pi * (first_reflection(wi, wo, alpha)[0] * wo[2]).mean()


def compensation(cosine, alpha, normal, mean):
    """Return 1 + F_ms (1 - E) / E, with F_avg as an integral."""
    c = (np.arange(10_000) + 0.5) / 10_000
    average = (2 * c * (normal + (1 - normal) * (1 - c) ** 5)).mean()
    bounces = average * mean / (1 - average * (1 - mean))
    albedo = directional_albedo(cosine, alpha)
    return 1 + bounces * (1 - albedo) / albedo


@pytest.mark.parametrize("roughness", ROUGHNESS)
@pytest.mark.parametrize("angle_deg", [slow(0), 45, slow(70), 85, slow(89)])
def test_white_rough_metal_absorbs_no_light(cpu_device, roughness, angle_deg):
    """The limit of 0.2 % is for 128 nodes of a table, each a mean of 4096 facets."""
    weight = samples_of(metal(roughness, (1.0, 1.0, 1.0)), leaning(angle_deg), 400_000)[2][0]
    error = weight.std() / np.sqrt(weight.size)
    assert error < 0.002
    assert abs(weight.mean() - 1) < 0.002 + 4 * error


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.3, 0.5, 1.0])
def test_the_value_of_rough_metal_agrees_with_the_published_formulas(cpu_device, roughness):
    """Oracle: other forms of D and G2, E summed over directions instead of facets, F_avg as an
    integral; the code under test uses none of them.
    """
    wo = upper(500, 3)
    wo = wo[:, wo[2] > 0.05]
    bsdf, alpha = metal(roughness), roughness**2
    node, share = np.polynomial.legendre.leggauss(16)
    cosine = 0.5 * (node + 1)
    mean = float(share @ (cosine * [directional_albedo(c, alpha) for c in cosine]))
    for angle_deg in (10, 60, 80):
        wi = leaning(angle_deg)
        shape, cos_half = first_reflection(wi[:, None], wo, alpha)
        value = evaluated(bsdf, wi, wo)[0]
        for channel, normal in enumerate(GOLD):
            fresnel = normal + (1 - normal) * (1 - cos_half) ** 5
            expected = fresnel * shape * compensation(wi[2], alpha, normal, mean)
            assert np.abs(value[channel] / expected - 1).max() < 0.002


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_the_lobe_of_a_single_reflection_has_the_published_shape(cpu_device, roughness):
    """The compensation is one factor for all outgoing directions, so the shape is that of one
    reflection, computed with other forms of D and G2.
    """
    alpha, wi = roughness**2, leaning(40)
    mirror = wi * [-1, -1, 1]
    wo = mirror[:, None] + 2 * alpha * np.random.default_rng(1).normal(size=(3, 400))
    wo /= np.linalg.norm(wo, axis=0)
    wo = wo[:, wo[2] > 0.05]
    value = evaluated(metal(roughness, (1.0, 1.0, 1.0)), wi, wo)[0][0]
    expected = first_reflection(wi[:, None], wo, alpha)[0]
    ratio = value / expected
    assert wo.shape[1] > 150
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.002
    assert ratio.min() > 0.998  # E is below 1, so the lobe only grows


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_facets_visible_at_normal_incidence_have_ggx_distributed_slopes(cpu_device, roughness):
    """Along the normal no facet hides another: tan^2 / (alpha^2 + tan^2) is the share of samples
    whose facet has a smaller slope (the integral of D cos). Kolmogorov's bound at one in a million.
    """
    n = 100_000
    wo = samples_of(metal(roughness), np.array([0.0, 0.0, 1.0]), n)[0]
    tangent2 = (wo[0] ** 2 + wo[1] ** 2) / (1 + wo[2]) ** 2
    share = np.sort(tangent2 / (roughness**4 + tangent2))
    assert np.abs(share - (np.arange(n) + 0.5) / n).max() < 2.7 / np.sqrt(n)


@pytest.mark.parametrize("roughness", ROUGHNESS)
@pytest.mark.parametrize("angle_deg", [slow(0), 50, slow(80)])
def test_sample_weights_are_the_value_divided_by_the_density(cpu_device, roughness, angle_deg):
    bsdf, wi = metal(roughness), leaning(angle_deg)
    wo, density, weight = samples_of(bsdf, wi, 5000)
    above = weight[0] > 0
    assert (density[~above] == 0).all() and (wo[2, above] > 0).all()
    value, again = evaluated(bsdf, wi, wo)
    value, again, weight = (value * wo[2])[:, above], again[above], weight[:, above]
    assert np.abs(again / density[above] - 1).max() < 5e-3  # the half vector again, in float32
    assert np.abs(value / again / weight - 1).max() < 1e-3


@pytest.mark.parametrize("roughness", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("angle_deg", [slow(0), 50, slow(80)])
def test_sample_densities_integrate_to_one_and_samples_follow_them(
    cpu_device, roughness, angle_deg
):
    assert_samples_fall_where_densities_say(metal(roughness), leaning(angle_deg), fine=512)


@pytest.mark.parametrize("angle_deg", [0, 60])
def test_samples_reflect_the_same_light_and_mean_direction_as_values(cpu_device, angle_deg):
    """Compare reflected light and its mean direction from samples with sums of values."""
    bsdf, wi, n = metal(0.7), leaning(angle_deg), 400_000
    wo, _, weight = samples_of(bsdf, wi, n)
    other = upper(n, 5)
    value = evaluated(bsdf, wi, other)[0] * other[2] * 2 * np.pi
    for moment, same in ((weight[1], value[1]), (weight[1] * wo, value[1] * other)):
        error = np.hypot(moment.std(axis=-1), same.std(axis=-1)) / np.sqrt(n)
        assert (np.abs(moment.mean(axis=-1) - same.mean(axis=-1)) < 5 * error).all()


def test_rougher_metal_reflects_less_light_and_saturates_its_colour(cpu_device):
    """Two reflections square a colour: half of the light that hits another facet is lost."""
    shares = [
        samples_of(metal(roughness, (0.5, 0.5, 0.5)), leaning(0), 100_000)[2][0].mean()
        for roughness in (0.1, 0.5, 1.0)
    ]
    assert abs(shares[0] - 0.5) < 0.002
    assert shares[0] > shares[1] + 0.01 > shares[2] + 0.1


def test_a_texture_replaces_the_colour_of_metal(cpu_device):
    """Two texels; smooth metal shows them at normal incidence (sRGB curve of IEC 61966-2-1)."""
    import drjit as dr
    import mitsuba as mi

    from graycast.rendering.mitsuba.scene import _bsdf

    texture = np.array([[[255, 188, 0]], [[100, 30, 255]]], dtype=np.uint8).repeat(8, axis=0)
    material = Material(texture=texture, metallic=1.0, roughness=0.1)
    bsdf, si = mi.load_dict(_bsdf(material)), arriving(np.array([0.0, 0.0, 1.0]), 2)
    si.uv = mi.Point2f([0.5, 0.5], [0.25, 0.75])
    wo = dr.zeros(mi.Vector3f, 2)
    wo.z = 1.0
    reflectance = np.array(bsdf.eval(mi.BSDFContext(), si, wo, True)).T * 4 * np.pi * 0.1**4
    level = texture[[0, -1], 0] / 255
    linear = np.where(level > 0.04045, ((level + 0.055) / 1.055) ** 2.4, level / 12.92)
    assert np.abs(reflectance - linear).max() < 0.002
    assert np.abs(np.array(bsdf.eval_diffuse_reflectance(si, True)).T - linear).max() < 1e-3


def test_the_back_of_a_metal_reflects_nothing(cpu_device):
    below = leaning(30) * [1, 1, -1]
    bsdf = metal(0.5)
    assert (samples_of(bsdf, below, 100)[2] == 0).all()
    for wi, wo in ((below, leaning(10)), (leaning(10), below), (below, below)):
        assert (evaluated(bsdf, wi, wo[:, None])[0] == 0).all()


def test_another_roughness_compiles_no_new_kernel(cpu_device):
    """Differences between metals are data: many materials, or another run, compile once."""
    import drjit as dr

    samples_of(metal(0.31), leaning(20), 64)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        samples_of(metal(0.77, (0.2, 0.3, 0.4)), leaning(20), 64)
        history = dr.kernel_history()
    launched = [kernel for kernel in history if "cache_hit" in kernel]
    assert launched and all(kernel["cache_hit"] for kernel in launched)
