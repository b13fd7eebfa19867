"""A map of roughness: each point is a material of its own roughness, and no light is lost."""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from bsdf_samples import arriving, leaning, upper
from PIL import Image
from stage import centred, in_camera, make_rig, plain_pattern, wall

from graycast.base.errors import ConfigError
from graycast.rendering import Quality
from graycast.world.parts import Material
from graycast.world.parts.material_section import MaterialSection, resolve_material
from graycast.world.parts.part_sections import PartSection, resolve_part
from graycast.world.scene import EMPTY_LAYOUT, Lamp

METAL = Material(base_color=(0.9, 0.6, 0.3), metallic=1.0, roughness=0.8)
PLASTIC = Material(base_color=(0.2, 0.3, 0.4), roughness=0.8)
BLACK = replace(PLASTIC, base_color=(0.0, 0.0, 0.0))
WHITE = {
    "metal": replace(METAL, base_color=(1.0, 1.0, 1.0), roughness=1.0),
    "plastic": replace(PLASTIC, base_color=(1.0, 1.0, 1.0), roughness=1.0),
}


def halves(left, right):
    """Return a map of two greys; no hit at u = 0.25 or 0.75 is at its border."""
    return np.repeat([[left, right]], 8, axis=1).astype(np.uint8)


def bsdf_of(material):
    import mitsuba as mi

    from graycast.rendering.mitsuba.scene import _bsdf

    return mi.load_dict(_bsdf(material))


def hits(wi, n, u):
    import mitsuba as mi

    si = arriving(wi, n)
    si.uv = mi.Point2f(u, 0.5)
    return si


def evaluated(bsdf, wi, wo, u=0.25):
    """Return values times the cosine (3, n), and densities."""
    import mitsuba as mi

    towards = mi.Vector3f(wo.astype(np.float32))
    value, density = bsdf.eval_pdf(mi.BSDFContext(), hits(wi, wo.shape[1], u), towards, True)
    return np.array(value, dtype=float), np.array(density, dtype=float)


def samples_of(bsdf, wi, n, u):
    """Return directions (3, n), densities and weights (3, n) of samples."""
    import mitsuba as mi

    one, *two = np.random.default_rng(0).random((3, n)).astype(np.float32)
    sample, weight = bsdf.sample(
        mi.BSDFContext(), hits(wi, n, u), mi.Float(one), mi.Point2f(*map(mi.Float, two)), True
    )
    return np.array(sample.wo, dtype=float), np.array(sample.pdf), np.array(weight, dtype=float)


@pytest.mark.slow
@pytest.mark.parametrize("look", [METAL, PLASTIC, replace(METAL, metallic=0.5)])
@pytest.mark.parametrize("grey", [slow(255), 130, slow(40)])
def test_a_uniform_roughness_map_equals_a_material_of_that_roughness(cpu_device, look, grey):
    """Oracle: the material without a map, whose tables are made for its roughness."""
    varied = replace(look, roughness_map=np.full((2, 3), grey, dtype=np.uint8))
    plain = replace(look, roughness=look.roughness * grey / 255)
    wo = upper(500, 3)
    wo = wo[:, wo[2] > 0.05]
    both = bsdf_of(varied), bsdf_of(plain)
    for angle_deg in (0, 45, 80):
        (value, density), (same, as_dense) = (
            evaluated(one, leaning(angle_deg), wo) for one in both
        )
        assert np.abs(value / same - 1).max() < 0.005
        assert np.abs(density / as_dense - 1).max() < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "grey"),
    [
        ("metal", 235), ("plastic", 26),
        slow("metal", 26), slow("metal", 97), slow("plastic", 97), slow("plastic", 235),
    ],
)  # fmt: skip
def test_a_white_surface_with_two_roughnesses_absorbs_no_light(cpu_device, kind, grey):
    """The limits are those of the BSDFs. The greys are between the rows of their tables."""
    bsdf = bsdf_of(replace(WHITE[kind], roughness_map=halves(255 - grey, grey)))
    for angle_deg in (0, 60, 84, 88):
        limit = {"metal": 0.004, "plastic": 0.003 if angle_deg < 85 else 0.005}[kind]
        for u in (0.25, 0.75):
            weight = samples_of(bsdf, leaning(angle_deg), 300_000, u)[2][0]
            error = weight.std() / np.sqrt(weight.size)
            assert error < 0.002
            assert abs(weight.mean() - 1) < limit + 3 * error, (angle_deg, u)


@pytest.mark.parametrize("look", [METAL, PLASTIC, BLACK])
@pytest.mark.parametrize("u", [0.25, slow(0.75)])
def test_a_sample_s_weight_is_the_value_divided_by_the_density_at_its_point(cpu_device, look, u):
    """The density also predicts how many are near the mirror direction; its integral is 1,
    including directions below the surface.
    """
    bsdf, wi, n = bsdf_of(replace(look, roughness_map=halves(110, 220))), leaning(50), 200_000
    wo, density, weight = samples_of(bsdf, wi, n, u)
    above = weight[0] > 0
    value, again = evaluated(bsdf, wi, wo[:, above], u)
    assert np.abs(again / density[above] - 1).max() < 5e-3
    assert np.abs(value / again / weight[:, above] - 1).max() < 1e-3
    other = upper(n, 4)
    share = evaluated(bsdf, wi, other, u)[1] * 2 * np.pi
    assert abs(share.mean() + (~above).mean() - 1) < 5 * share.std() / np.sqrt(n) + 0.002
    mirror = wi * [-1, -1, 1]
    close = share * (mirror @ other > 0.95)
    fallen = (above & (mirror @ wo > 0.95)).mean()
    assert abs(close.mean() - fallen) < 5 * close.std() / np.sqrt(n) + 0.002


@pytest.mark.parametrize(("look", "normal"), [(METAL, 0.9), (BLACK, 0.04)])
def test_highlights_have_the_radiance_of_the_local_roughness(cpu_device, look, normal):
    """At normal incidence, `F D / 4` is `F / (4 pi roughness^4)`; later reflections add at most 0.3
    %, and black has no base.
    """
    look = replace(look, roughness=0.5, roughness_map=halves(51, 102))
    up = np.array([[0.0], [0.0], [1.0]])
    for u, roughness in ((0.25, 0.1), (0.75, 0.2)):
        value = evaluated(bsdf_of(look), up[:, 0], up, u)[0][0]
        assert value == pytest.approx(normal / (4 * np.pi * roughness**4), rel=0.003)


@pytest.mark.parametrize(
    ("engine", "noise"), [("mitsuba", 0.01), pytest.param("cycles", 0.05, marks=pytest.mark.slow)]
)
def test_each_quarter_of_a_mapped_wall_equals_a_wall_of_that_roughness(request, engine, noise):
    """Oracle: pictures of walls of one roughness. Row 0 of the map is at the top of the picture."""
    renderer = request.getfixturevalue(f"{engine}_renderer")
    rig = make_rig(centred(16, 16, 20), centred(8, 8, 8))
    lamp = Lamp(
        center_m=(0.3, -0.2, -0.5), target_m=(0.0, 0.0, 1.0), size_m=0.3, radiance=(9.0,) * 3
    )
    greys = np.array([[90, 130], [170, 255]], dtype=np.uint8)

    def picture(material):
        return renderer.render(
            in_camera(rig, wall(1.0, material, half_m=0.4), lamps=(lamp,), T_world_cam=np.eye(4)),
            EMPTY_LAYOUT,
            plain_pattern(rig, 0),
            quality=Quality(samples=64, depth=1),
            seed=0,
        ).radiance.ambient_rgb[..., 0]

    fine = greys.repeat(32, axis=0).repeat(32, axis=1)
    varied = picture(replace(METAL, roughness=0.9, roughness_map=fine))
    for row, column in np.ndindex(2, 2):
        plain = picture(replace(METAL, roughness=0.9 * float(greys[row, column]) / 255))
        quarter = np.s_[8 * row + 1 : 8 * row + 7, 8 * column + 1 : 8 * column + 7]
        assert plain[quarter].min() > 0
        assert np.abs(varied[quarter] / plain[quarter] - 1).max() < noise


def test_a_roughness_map_with_one_smooth_pixel_makes_metal_count_as_shiny(cpu_device):
    from graycast.rendering.mitsuba.scene import _is_shiny

    scratch = np.full((9, 9), 255, dtype=np.uint8)
    assert not _is_shiny(replace(METAL, roughness_map=scratch))
    scratch = scratch.copy()
    scratch[4, 4] = 60
    assert _is_shiny(replace(METAL, roughness_map=scratch))


def test_no_point_of_a_roughness_map_becomes_a_perfect_mirror():
    varied = replace(METAL, roughness_map=np.array([[0, 3, 4, 255]], dtype=np.uint8))
    assert varied.local_roughness[0] == pytest.approx([0.01, 0.01, 0.8 * 4 / 255, 0.8])
    assert varied.smoothest == 0.01 and METAL.smoothest == 0.8


def test_a_roughness_map_is_read_without_gamma(tmp_path):
    level = np.arange(256, dtype=np.uint8).reshape(16, 16)
    Image.fromarray(level).save(tmp_path / "grey.png")
    Image.fromarray(np.stack([level] * 3, axis=-1)).save(tmp_path / "rgb.png")
    for name in ("grey.png", "rgb.png"):
        material = resolve_material(MaterialSection(preset="steel", roughness_map=name), tmp_path)
        assert np.array_equal(material.roughness_map, level)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({"roughness_map": "none.png"}, "roughness_map .*none.png: .*; give a PNG or JPEG picture"),
        ({"roughness_map": "deep.png"}, "of the kind I;16: save it with 8 bits of grey"),
        ({"roughness_map": "red.png"}, "has colours.*: save it with 8 bits of grey"),
        ({"preset": "steel-brushed"}, "roughness_map has an anisotropy: remove one of the two"),
        ({"transparent": "solid"}, "roughness_map is transparent: remove one of the two"),
    ],
)
def test_an_invalid_roughness_map_is_refused_in_one_line(tmp_path, words, says):
    Image.fromarray(np.zeros((4, 4), dtype=np.uint8)).save(tmp_path / "grey.png")
    Image.fromarray(np.zeros((4, 4), dtype=np.uint16)).save(tmp_path / "deep.png")
    Image.fromarray(np.full((4, 4, 3), (200, 0, 0), dtype=np.uint8)).save(tmp_path / "red.png")
    section = MaterialSection(**({"roughness_map": "grey.png"} | words))
    with pytest.raises(ConfigError, match=says) as error:
        resolve_material(section, tmp_path)
    assert "\n" not in str(error.value)


def test_a_roughness_map_on_a_built_in_part_needs_texture_coordinates(tmp_path):
    Image.fromarray(np.zeros((4, 4), dtype=np.uint8)).save(tmp_path / "grey.png")
    look = MaterialSection(roughness_map="grey.png")
    with pytest.raises(ConfigError, match="metal_workpiece_1 has no texture coordinates: remove"):
        resolve_part(PartSection(builtin="metal_workpiece_1", material=look), tmp_path)
