"""Materials by name: colours of metals from published indices; one key overrides one property."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from graycast.base.errors import ConfigError
from graycast.cell.config import load_config
from graycast.cell.domain.looks import retouched
from graycast.dataset.write.claim import part_digest
from graycast.world.parts import MATERIALS, Grain, Material, Mesh, builtin_part, material_preset
from graycast.world.parts.material_section import MaterialSection, resolve_material
from graycast.world.parts.part import corner_grain
from graycast.world.parts.part_sections import resolve_part
from graycast.world.scene import Sphere

# (wavelength [um], n, k) around 610, 550 and 465 nm, as printed in the sources of `MATERIALS`.
INDICES = {
    "steel-polished": (
        (0.451, 2.59, 2.77), (0.471, 2.67, 2.82), (0.549, 2.95, 2.93), (0.582, 2.94, 2.99),
        (0.617, 2.88, 3.05),
    ),
    "stainless-polished": (
        (0.46, 1.5372, 2.8162), (0.48, 1.6307, 2.9055), (0.54, 1.8730, 3.1404),
        (0.56, 1.9355, 3.2004), (0.60, 2.0565, 3.3248), (0.62, 2.1139, 3.3881),
    ),
    "aluminium-cast": (
        (0.44280, 0.6079, 5.3676), (0.47687, 0.7278, 5.7781), (0.51660, 0.8734, 6.2418),
        (0.56357, 1.0728, 6.7839), (0.61993, 1.3660, 7.4052),
    ),
    "chrome": (
        (0.451, 2.33, 3.14), (0.471, 2.51, 3.24), (0.549, 3.18, 3.33), (0.582, 3.22, 3.30),
        (0.617, 3.17, 3.30),
    ),
    "copper": (
        (0.4509, 1.24, 2.397), (0.4714, 1.25, 2.483), (0.5486, 1.02, 2.577),
        (0.5821, 0.70, 2.704), (0.6168, 0.30, 3.205),
    ),
    "brass": (
        (0.46, 0.994, 1.883), (0.47, 0.900, 1.957), (0.55, 0.527, 2.765), (0.61, 0.452, 3.345),
    ),
    "zinc": (
        (0.450852, 0.6794, 4.0209), (0.495937, 0.7858, 4.4636),
        (0.551041, 0.9322, 4.9850), (0.619921, 1.1356, 5.6116),
    ),
}  # fmt: skip
INDICES["steel-oiled"] = INDICES["steel-polished"]


@pytest.mark.parametrize("name", INDICES)
def test_the_colour_of_a_metal_preset_is_its_reflectance_at_normal_incidence(name):
    """Oracle: |(N - m) / (N + m)|^2 of the complex index N = n + i k, at three wavelengths; m is 1
    in air and 1.47 in oil.
    """
    wavelength_um, n, k = np.array(INDICES[name]).T
    at_um = (0.610, 0.550, 0.465)
    index = np.interp(at_um, wavelength_um, n) + 1j * np.interp(at_um, wavelength_um, k)
    material = MATERIALS[name].material
    around = 1.0 if material.film is None else 1.47
    assert material.film is None or abs(material.ior - around) < 1e-9
    reflectance = np.abs((index - around) / (index + around)) ** 2
    assert np.abs(reflectance - material.base_color).max() < 6e-4  # three digits
    assert material.metallic == 1


def test_every_metal_with_a_cited_source_is_in_the_comparison():
    with_source = {
        preset.material.base_color
        for preset in MATERIALS.values()
        if preset.material.metallic and preset.source != "our choice"
    }
    assert with_source == {MATERIALS[name].material.base_color for name in INDICES}


# Reflectance at 460, 470, 550 and 610 nm, measured by physicallybased.info.
REFLECTANCES = {
    "cast-iron": (0.02685, 0.02687, 0.02650, 0.02685),
    "rust": (0.02563, 0.02680, 0.06761, 0.15199),
    "rubber": (0.02333, 0.02316, 0.02261, 0.02328),
    "cardboard": (0.12575, 0.13060, 0.22421, 0.31028),
    "paper": (0.90938, 0.91431, 0.80154, 0.81728),
}


@pytest.mark.parametrize("name", REFLECTANCES)
def test_the_colour_of_a_nonmetal_preset_is_its_measured_reflectance(name):
    """Symptom: rust could be blue. The colour has three digits; that of rubber is one grey."""
    red, green, blue = MATERIALS[name].material.base_color
    assert MATERIALS[name].material.metallic == 0
    measured = np.array(REFLECTANCES[name])
    assert np.abs(np.array([blue, green, red]) - [measured[:2].mean(), *measured[2:]]).max() < 6e-4


def test_every_nonmetal_with_a_measured_colour_is_in_the_comparison():
    measured = {name for name, preset in MATERIALS.items() if "measured" in preset.source}
    assert measured == set(REFLECTANCES)


def resolved(words, own=None):
    return resolve_material(MaterialSection.model_validate(words), Path(), own=own)


def test_a_preset_name_gives_its_material_and_a_key_overrides_one_property():
    brass = MATERIALS["brass"].material
    assert resolved({"preset": "brass"}) == brass
    assert resolved({"preset": "brass", "roughness": 0.4}) == replace(brass, roughness=0.4)


def test_a_preset_replaces_the_whole_material_of_a_built_in_part():
    label = builtin_part("toothpaste").material
    line = Material(texture=label.texture, projector_reflectance=0.3)
    assert resolved({"preset": "rubber"}, own=line) == MATERIALS["rubber"].material


@pytest.mark.parametrize("material", ["brass", {"preset": "brass"}])
def test_a_configuration_may_have_a_preset_name_instead_of_a_material_section(tmp_path, material):
    part = {"builtin": "metal_workpiece_1", "material": material}
    content = {"parts": [part], "table": "rubber", "bin": {"material": "paper", "floor": "rust"}}
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(content))
    config = load_config(path)
    assert resolve_part(config.parts[0], tmp_path)[0].material == MATERIALS["brass"].material
    assert (config.table.preset, config.bin.material.preset) == ("rubber", "paper")
    assert config.bin.floor.preset == "rust"


@pytest.mark.parametrize(
    ("material", "line"),
    [
        ("brss", "parts.0.material.preset is 'brss': no material has the name 'brss'; did you"),
        ("aluminium", "did you mean aluminium-cast or aluminium-machined or aluminium-turned or"),
        ("aluminum", "did you mean aluminium-cast or aluminium-turned or aluminium-milled or"),
        ("Steel turned", "did you mean steel-turned?"),
        ("iron", "did you mean cast-iron?"),
        ("unobtainium", "choose steel, steel-polished,"),
        ({"preset": "bras"}, "did you mean brass?"),
        ({"preset": "brass", "rougness": 0.2}, "did you mean roughness?"),
        (7, "parts.0.material"),
    ],
)
def test_a_wrong_preset_name_is_refused_in_one_line(tmp_path, material, line):
    path = tmp_path / "cell.yaml"
    part = {"builtin": "toothpaste", "material": material}
    path.write_text(yaml.safe_dump({"parts": [part]}))
    with pytest.raises(ConfigError) as refusal:
        load_config(path)
    assert line in str(refusal.value) and "\n" not in str(refusal.value)


def test_material_preset_in_python_knows_the_names_of_the_configuration():
    assert material_preset("zinc") is MATERIALS["zinc"]
    with pytest.raises(ValueError, match="did you mean zinc"):
        MaterialSection(preset="zink")


# --- grooves -----------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [{}, {"metallic": 1.0}, {"grain": Grain(axis=(1.0, 0.0, 0.0))}])
def test_anisotropy_without_metal_or_a_grain_is_refused(words):
    with pytest.raises(ValueError, match=r"needs metal .* and the direction of its grooves"):
        Material(anisotropy=0.5, **words)


def test_a_grain_on_a_sphere_is_refused():
    with pytest.raises(ValueError, match="a sphere has no grain"):
        Sphere(center_m=(0.0, 0.0, 0.0), radius_m=1.0, material=MATERIALS["steel-brushed"].material)


def test_roughness_along_and_across_grooves_follows_burley_s_formula():
    """The widths have the product of the plain metal and the ratio 1 / (1 - 0.9 anisotropy)."""
    for anisotropy in (0.0, 0.6, 1.0):
        grain = Grain(axis=(1.0, 0.0, 0.0))
        metal = Material(metallic=1.0, roughness=0.3, anisotropy=anisotropy, grain=grain)
        along, across = metal.alphas
        assert abs(along * across - 0.3**4) < 1e-12
        assert abs(across / along - 1 / (1 - 0.9 * anisotropy)) < 1e-9


def test_groove_keys_of_a_material_are_applied():
    brushed = MATERIALS["steel-brushed"].material
    lathe = Grain(axis=(0.0, 1.0, 0.0), turned=True, point_m=(0.1, 0.0, 0.0))
    turned = {"preset": "steel-brushed", "turned": "y", "turned_about_m": [0.1, 0, 0]}
    assert resolved(turned) == replace(brushed, grain=lathe)
    along = Grain(axis=(0.0, 0.6, 0.8))
    assert resolved({"preset": "steel-brushed", "grain": [0, 3, 4]}).grain == along
    plain = resolved({"preset": "steel-brushed", "anisotropy": 0.0})
    assert plain.alphas == (plain.roughness**2,) * 2


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ({"preset": "brass", "grain": "x"}, "grain and turned need an anisotropy"),
        ({"preset": "brass", "anisotropy": 0.5}, "the direction of its grooves"),
        ({"anisotropy": 0.5, "grain": "x"}, "needs metal"),
        ({"preset": "steel-brushed", "grain": "x", "turned": "z"}, "remove one of them"),
        ({"preset": "steel-turned", "turned_about_m": [0, 0, 0]}, "belongs to turned"),
        ({"preset": "steel-brushed", "grain": [0, 0, 0]}, "an axis must have a direction"),
    ],
)
def test_grooves_that_have_no_effect_are_refused(words, line):
    with pytest.raises((ConfigError, ValueError), match=line):
        resolved(words)


def test_scaling_a_part_scales_the_axis_position_of_its_lathe_grooves():
    part = builtin_part("metal_workpiece_2")
    lathe = Grain(axis=(0.0, 0.0, 1.0), turned=True, point_m=(0.01, 0.0, 0.0))
    metal = replace(MATERIALS["steel-turned"].material, grain=lathe)
    assert replace(part, material=metal).scaled(2.0).material.grain.point_m == (0.02, 0.0, 0.0)
    assert part.scaled(2.0).material == part.material


def test_grooves_of_a_brushed_box_are_within_every_face():
    """On every face, the direction is in the face, and along the grain if possible."""
    corner_m = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1.0)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    mesh = Mesh(vertices_m=corner_m, faces=faces)
    way = corner_grain(mesh, Grain(axis=(2.0, 0.0, 0.0)))
    ends = np.abs(mesh.face_normal[:, 0]) > 0.5
    assert np.allclose(way[~ends], [1, 0, 0]) and np.allclose(way[ends], [0, 1, 0])
    lathe = corner_grain(mesh, Grain(axis=(0.0, 0.0, 1.0), turned=True))
    assert np.allclose(lathe, np.cross([0, 0, 1.0], corner_m[faces]))
    far = corner_grain(mesh, Grain(axis=(0.0, 0.0, 1.0), turned=True, point_m=(50.0, 0.0, 0.0)))
    radial = np.abs(mesh.face_normal[:, 1]) > 0.5  # a keyway's walls, seen from an axis far away
    assert np.allclose(far[radial], [0, 0, 1]) and np.allclose(
        far[ends][..., 0], -corner_m[faces[ends]][..., 1]
    )


def test_varying_the_look_keeps_grooves_only_on_metal():
    brushed = MATERIALS["steel-brushed"].material
    less = retouched(brushed, brightness=1.0, roughness=0.0, metallic=-0.5)
    none = retouched(brushed, brightness=1.0, roughness=0.0, metallic=-1.0)
    assert (less.anisotropy, none.anisotropy) == (0.8, 0.0)


def test_the_direction_of_grooves_changes_the_digest_of_a_part():
    part = replace(builtin_part("toothpaste"), material=MATERIALS["steel-brushed"].material)
    other = replace(part.material, grain=Grain(axis=(0.0, 1.0, 0.0)))
    assert part_digest(part) != part_digest(replace(part, material=other))
    assert part_digest(part) != part_digest(replace(part, material=MATERIALS["steel"].material))


# n^2 - 1 = sum of b l^2 / (l^2 - c), as printed in the sources; l is the wavelength [um].
SELLMEIER = {
    "glass-clear": (
        (1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653),
    ),
    "pmma-clear": ((1.1819, 0.011313),),
}  # fmt: skip


@pytest.mark.parametrize("name", SELLMEIER)
def test_a_transparent_material_has_the_refractive_index_of_its_source(name):
    """Oracle: Sellmeier's equation at the helium line."""
    line2 = 0.5876**2
    index = np.sqrt(1 + sum(b * line2 / (line2 - c) for b, c in SELLMEIER[name]))
    assert abs(MATERIALS[name].material.ior - index) < 1e-4


def test_glass_that_is_metal_or_has_a_texture_is_refused():
    for words, name in (({"metallic": 0.5}, "metallic"), ({"texture": TEXTURE}, "texture")):
        with pytest.raises(ValueError, match=name):
            Material(transparent="solid", **words)
    section = MaterialSection(transparent="thin", color_depth_m=0.02)
    with pytest.raises(ConfigError, match="color_depth_m belongs to transparent: solid"):
        resolve_material(section, Path())
    assert retouched(MATERIALS["glass-clear"].material, brightness=1.0, roughness=0.0, metallic=0.3)


FINISHES = (
    "aluminium-blasted", "aluminium-anodised", "aluminium-milled", "steel-ground", "steel-cast",
    "steel-sheet",
)  # fmt: skip


@pytest.mark.parametrize("name", FINISHES)
def test_only_the_finish_of_blasted_aluminium_is_called_measured(name):
    preset = MATERIALS[name]
    assert preset.material.metallic == 1 and "our choice" in preset.surface
    measured = "measured" in preset.surface
    assert measured == (name == "aluminium-blasted")


def test_blasted_aluminium_has_the_mottle_of_the_scanned_plate():
    """Oracle: the white frame of a real scan, in pixels of 0.28 mm. Their deviation is 0.18 of the
    local mean, the correlation of neighbours 0.18 along and 0.27 across another part of the plate.

    A pixel averages the law `exp(-(r / length)^2)` over a square, so along each axis the products
    of two pixels are weighted by a triangle.
    """
    material, pixel_m = MATERIALS["aluminium-blasted"].material, 0.00028
    between_m = np.linspace(-pixel_m, pixel_m, 2001)
    weight = 1 - np.abs(between_m) / pixel_m
    weight /= weight.sum()

    def product(apart_m):
        return weight @ np.exp(-(((between_m + apart_m) / material.mottle_length_m) ** 2))

    assert material.mottle * product(0.0) == pytest.approx(0.18, rel=0.1)  # the same along y
    assert 0.18 < product(pixel_m) / product(0.0) < 0.27


TEXTURE = np.zeros((2, 2, 3), dtype=np.uint8)
