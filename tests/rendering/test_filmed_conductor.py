"""Metal under oil: conservation of energy, plates in closed form, and a random walk in the film."""

from contextlib import nullcontext

import numpy as np
import pytest
from backends import slow
from bsdf_samples import assert_samples_fall_where_densities_say, evaluated, leaning, samples_of
from stage import centred, in_camera, make_rig, wall

from graycast.rendering.wavelength import refuse_layers
from graycast.world.parts import Material

INDEX = 1.47


def filmed(roughness, film, reflectance=(1.0, 0.5, 0.1), index=INDEX):
    import mitsuba as mi

    import graycast.rendering.mitsuba.scene  # noqa: F401  (registers the material)

    color = {"type": "rgb", "value": list(reflectance)}
    words = {"alpha": roughness**2, "film_alpha": film**2, "eta": index, "reflectance": color}
    return mi.load_dict({"type": "filmed_conductor"} | words)


def fresnel(cosine, index=INDEX):
    """Return the unpolarised reflectance of a plane film, by the two angles."""
    angle = np.arccos(np.minimum(cosine, 1 - 1e-12))
    inside = np.arcsin(np.sin(angle) / index)
    across = np.sin(angle - inside) / np.sin(angle + inside)
    return 0.5 * across**2 * (1 + (np.cos(angle + inside) / np.cos(angle - inside)) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [slow(0.05), 0.3, slow(0.5), 0.8])
@pytest.mark.parametrize("film", [0.02, slow(0.3)])
def test_white_metal_under_a_film_absorbs_no_light(cpu_device, roughness, film):
    bsdf = filmed(roughness, film)
    for angle_deg in (0, 45, 70, 85):
        weight = samples_of(bsdf, leaning(angle_deg), 400_000)[2]
        assert abs(weight[0].mean() - 1) < 0.005, angle_deg


@pytest.mark.parametrize("angle_deg", [0, 45, 70, 80])
def test_a_smooth_film_on_smooth_metal_reflects_the_sum_of_all_paths(cpu_device, angle_deg):
    """`E + T^2 R / (1 - R E)` to 1 %, with Schlick's R at the angle inside: `S_2` is a mean over
    all angles.
    """
    weight = samples_of(filmed(0.05, 0.02), leaning(angle_deg), 400_000)[2].mean(axis=1)
    cosine = np.cos(np.radians(angle_deg))
    film, inside = fresnel(cosine), np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    for band, normal in enumerate((1.0, 0.5, 0.1)):
        metal = normal + (1 - normal) * (1 - inside) ** 5
        planes = film + (1 - film) ** 2 * metal / (1 - metal * film)
        assert abs(weight[band] / planes - 1) < 0.012, band


def walked(wi, alpha, n, index=INDEX):
    """Return directions and weights of light that leaves a plane film over GGX facets.

    Facets by their whole distribution and Heitz' Lambda, refraction by Snell's angles.
    """
    rng = np.random.default_rng(0)
    tangent, turn = alpha * np.sqrt(1 / (1 - rng.random(n)) - 1), 2 * np.pi * rng.random(n)
    facet = np.stack([tangent * np.cos(turn), tangent * np.sin(turn), np.ones(n)])
    facet /= np.linalg.norm(facet, axis=0)
    angle = np.arcsin(np.sin(np.arccos(wi[2])) / index)
    inside = np.array([np.sin(angle), 0.0, np.cos(angle)])
    met = inside @ facet
    out = 2 * met * facet - inside[:, None]
    masked = [
        0.5 * (np.sqrt(1 + alpha**2 * (1 / np.minimum(w[2] ** 2, 1) - 1)) - 1)
        for w in (inside, out)
    ]
    weight = met / (facet[2] * inside[2]) / (1 + masked[0] + masked[1])
    sine = index * np.hypot(out[0], out[1])
    leaves = (met > 0) & (out[2] > 0) & (sine < 1)
    up = np.sqrt(1 - np.minimum(sine, 1 - 1e-9) ** 2)
    above = np.stack([index * out[0], index * out[1], up])
    return above[:, leaves], (weight * (1 - fresnel(up)))[leaves]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("roughness", "angle_deg"), [slow(0.3, 0), slow(0.3, 50), (0.5, 30), slow(0.7, 60)]
)
def test_the_lobe_of_filmed_metal_agrees_with_a_random_walk(cpu_device, roughness, angle_deg):
    """In 12 x 12 cells of the hemisphere, without those where the film itself reflects: 1 % plus
    four times the noise of the walk."""
    wi = leaning(angle_deg)
    above, weight = walked(wi, roughness**2, 1_000_000)
    fine, cells = 480, 12
    z, turn = (np.arange(fine) + 0.5) / fine, 2 * np.pi * (np.arange(fine) + 0.5) / fine
    across = np.sqrt(1 - z * z)[:, None]
    grid = np.stack(
        [across * np.cos(turn), across * np.sin(turn), np.repeat(z[:, None], fine, axis=1)]
    ).reshape(3, -1)
    value = evaluated(filmed(roughness, 0.02), wi, grid)[0][0] * grid[2]
    ours = value.reshape(cells, fine // cells, cells, fine // cells).mean(axis=(1, 3))
    place = np.arctan2(above[1], above[0]) % (2 * np.pi)
    ranges = [[0, 1], [0, 2 * np.pi]]
    theirs, square = (
        np.histogram2d(above[2], place, bins=cells, range=ranges, weights=weight**power)[0]
        for power in (1, 2)
    )
    away = np.arccos(np.clip(np.array([-wi[0], -wi[1], wi[2]]) @ grid, -1, 1))
    near = (away < 0.1).reshape(cells, fine // cells, cells, fine // cells).any(axis=(1, 3))
    noise = np.sqrt(square) / np.maximum(theirs, 1e-9)
    sure = (theirs > 0) & (noise < 0.03) & ~near
    assert sure.sum() >= 20
    ratio = (ours / np.maximum(theirs, 1e-9))[sure]
    ratio /= np.average(ratio, weights=theirs[sure])
    assert (np.abs(ratio - 1) < 0.01 + 4 * noise[sure]).all()


@pytest.mark.slow
@pytest.mark.parametrize(("roughness", "film", "angle_deg"), [(0.5, 0.4, 30), slow(0.7, 0.5, 70)])
def test_samples_of_filmed_metal_follow_the_density(cpu_device, roughness, film, angle_deg):
    assert_samples_fall_where_densities_say(filmed(roughness, film), leaning(angle_deg), fine=800)


@pytest.mark.parametrize("angle_deg", [0, 60])
def test_sample_weights_are_the_value_divided_by_the_density(cpu_device, angle_deg):
    bsdf, wi = filmed(0.3, 0.3), leaning(angle_deg)
    wo, density, weight = samples_of(bsdf, wi, 20_000)
    above = weight[0] > 0
    value, again = evaluated(bsdf, wi, wo[:, above])
    assert np.abs(density[above] / again - 1).max() < 1e-3
    assert np.abs(value * wo[2, above] / again / weight[:, above] - 1).max() < 1e-3


def test_only_metal_may_have_a_film():
    assert Material(metallic=1.0, film=0.05).words["film"] == 0.05
    for words, message in (
        ({"film": 0.05}, "has metallic 0"),
        ({"film": 0.05, "metallic": 1.0, "specular": 0.0}, "has specular 0"),
        ({"film": 0.05, "metallic": 1.0, "roughness_map": np.zeros((2, 2), np.uint8)}, "has rough"),
    ):
        with pytest.raises(ValueError, match=message):
            Material(**words)


@pytest.mark.parametrize("film", [None, 0.05])
def test_only_mitsuba_renders_a_film(film):
    surface = wall(1.0, Material(metallic=1.0, film=film))
    scene = in_camera(make_rig(centred(8, 6, 10), centred(8, 6, 10)), surface)
    with nullcontext() if film is None else pytest.raises(ValueError, match="Cycles cannot render"):
        refuse_layers(scene, "Cycles")
