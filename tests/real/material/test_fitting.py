"""Fits of light that the renderer's own BSDF, or Lambert's law, has made with known numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from graycast.base.errors import ConfigError, GraycastError
from graycast.cell.new_cell import fitted_surface
from graycast.real.material import fitting
from graycast.real.material.fitting import fit_material, scale_of
from graycast.real.material.material_files import describe_fit, draw_fit, material_text
from graycast.real.material.observing import Reflections
from graycast.real.material.surface_model import SurfaceModel, mean_light, surface
from graycast.world.parts import Material
from graycast.world.parts.material_section import MaterialSection, resolve_material

SCALE = 5000.0


def heap(n, *, widest_rad, seed):
    """Directions of surfaces that lean up to an angle, under a projector at 20 degrees."""
    rng = np.random.default_rng(seed)
    lean, turn = widest_rad * np.sqrt(rng.random(n)), 2 * math.pi * rng.random(n)
    normal = np.stack(
        [np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)], axis=-1
    )
    camera = np.tile([0.0, 0.0, -1.0], (n, 1))
    projector = np.tile([math.sin(0.35), 0.0, -math.cos(0.35)], (n, 1))
    return Reflections(
        normal=normal,
        to_camera=camera,
        to_projector=projector,
        light=np.ones(n),
        sigma=np.full(n, 1e-3),
        clipped=np.zeros(n, dtype=bool),
        normal_sigma_rad=np.full(n, 0.004),
        area_px=np.full(n, 10.0),
        pixel=np.stack([np.arange(n), np.zeros(n, dtype=np.int64)], axis=-1),
        point_m=np.zeros((n, 3)),
    )


def lit(pixels, material, *, scatter=0.05, seed=1):
    """Return the pixels with the light of a material and random relative errors."""
    rng = np.random.default_rng(seed)
    light = SCALE * mean_light(pixels, material) * (1 + scatter * rng.normal(size=len(pixels)))
    changed = {name: getattr(pixels, name) for name in pixels.__slots__} | {"light": light}
    return Reflections(**changed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "color", "roughness"), [("metal", 0.9, 0.55), ("plastic", 0.3, 0.4)]
)
def test_the_fit_returns_kind_color_and_roughness_inside_its_intervals(
    cpu_device, kind, color, roughness
):
    pixels = heap(2000, widest_rad=0.7, seed=3)
    fit = fit_material(lit(pixels, surface(kind, color, roughness)), scale=SCALE, seed=0)
    assert fit.kind == kind
    assert fit.roughness.low <= roughness <= fit.roughness.high
    assert fit.color.low <= color <= fit.color.high
    assert fit.roughness.value == pytest.approx(roughness, abs=0.02)
    assert fit.color.value == pytest.approx(color, rel=0.04)
    assert fit.scatter == pytest.approx(0.05, abs=0.015)


@pytest.mark.slow
def test_the_color_of_metal_is_not_determined_without_a_scale(cpu_device, tmp_path):
    """Twice the light of a projector of unknown intensity is no other metal."""
    pixels = lit(heap(2000, widest_rad=0.5, seed=3), surface("metal", 0.5, 0.4))
    fit = fit_material(pixels, scale=None, seed=0)
    assert fit.roughness.value == pytest.approx(0.4, abs=0.03)
    ratio = pixels.light / (fit.scale * mean_light(pixels, fit.material))
    assert np.median(ratio) == pytest.approx(1, abs=0.03), "scale and colour are of one fit"
    text = material_text(fit, "stack.yaml")
    assert "# base_color is not determined" in text
    assert any("--reference" in line for line in describe_fit(fit))
    draw_fit(fit, pixels, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_saturated_highlight_does_not_make_metal_rougher(cpu_device):
    """A third of the pixels are saturated; as exact values, they would flatten the highlight."""
    pixels = lit(heap(2000, widest_rad=0.4, seed=3), surface("metal", 0.7, 0.3))
    limit = float(np.quantile(pixels.light, 0.67))
    names = {name: getattr(pixels, name) for name in pixels.__slots__}
    names["light"] = np.minimum(pixels.light, limit)
    believed = fit_material(Reflections(**names), scale=SCALE, seed=0)
    names["clipped"] = pixels.light > limit
    fit = fit_material(Reflections(**names), scale=SCALE, seed=0)
    assert fit.roughness.value == pytest.approx(0.3, abs=0.02)
    assert believed.roughness.value > 0.35


@pytest.mark.slow
@pytest.mark.parametrize("scale", [SCALE, None])
def test_a_known_metal_gets_its_scattered_share(cpu_device, scale):
    """Oracle: the renderer's BSDF of a metal that scatters 40 % of its light."""
    true = Material(base_color=(0.8,) * 3, metallic=1.0, roughness=0.35, diffuse=0.4)
    pixels = lit(heap(2000, widest_rad=0.6, seed=3), true)
    fit = fit_material(pixels, scale=scale, metal=True, seed=0)
    assert fit.roughness.value == pytest.approx(0.35, abs=0.02)
    assert fit.diffuse.low <= 0.4 <= fit.diffuse.high
    assert fit.diffuse.value == pytest.approx(0.4, abs=0.05)
    ratio = pixels.light / (fit.scale * mean_light(pixels, fit.material))
    assert np.median(ratio) == pytest.approx(1, abs=0.03)
    text = material_text(fit, "stack.yaml")
    if scale is None:
        assert "# base_color is not determined" in text
    else:
        assert fit.color.low <= 0.8 <= fit.color.high
        assert fit.color.value == pytest.approx(0.8, rel=0.05)
    assert "diffuse: 0." in text


@pytest.mark.slow
def test_roughness_is_not_determined_from_one_angle(cpu_device):
    pixels = lit(heap(800, widest_rad=0.01, seed=3), surface("plastic", 0.5, 0.5))
    fit = fit_material(pixels, scale=SCALE, seed=0)
    assert fit.roughness.high - fit.roughness.low > fitting.WIDE
    assert any("roughness is not determined" in line for line in describe_fit(fit))


@pytest.mark.slow
def test_light_that_fits_no_material_is_refused(cpu_device):
    """Light at random, over three orders of magnitude, as through glass."""
    pixels = heap(800, widest_rad=0.5, seed=3)
    light = SCALE * np.exp(2 * np.random.default_rng(0).normal(size=800))
    changed = {name: getattr(pixels, name) for name in pixels.__slots__} | {"light": light}
    with pytest.raises(GraycastError, match="several materials, glass"):
        fit_material(Reflections(**changed), scale=SCALE, seed=0)


@pytest.mark.slow
def test_a_polished_metal_without_its_highlight_is_refused(cpu_device):
    """A lobe of 1 degree, and surfaces whose half angles begin at 6 degrees."""
    pixels = heap(4000, widest_rad=0.3, seed=3)
    pixels = pixels.part(np.flatnonzero(pixels.half_angle_rad > 0.105))
    light = lit(pixels, surface("metal", 0.6, 0.13))
    with pytest.raises(GraycastError, match="no pixel shows the highlight"):
        fit_material(light, scale=SCALE, seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("metal", [False, True])
def test_a_smooth_surface_with_many_dark_and_saturated_pixels_is_refused_as_polished(
    metal, cpu_device
):
    pixels = lit(heap(800, widest_rad=0.5, seed=3), surface("metal", 0.6, 0.25))
    polished = replace(pixels, dark_share=0.08, saturated_share=0.03)
    with pytest.raises(GraycastError, match="8% of the pixels return no light and 3% are sat"):
        fit_material(polished, scale=SCALE, metal=metal, seed=0)
    shadowed = replace(polished, saturated_share=0.005)
    fit = fit_material(shadowed.part(np.arange(700)), scale=SCALE, metal=metal, seed=0)
    assert fit.roughness.value == pytest.approx(0.25, abs=0.05)


def test_a_part_of_the_pixels_keeps_the_shares_of_the_surface():
    whole = replace(heap(20, widest_rad=0.5, seed=3), dark_share=0.25, saturated_share=0.5)
    part = whole.part(np.array([1, 4]))
    assert (len(part), part.dark_share, part.saturated_share) == (2, 0.25, 0.5)
    assert np.array_equal(part.normal, whole.normal[[1, 4]])


def test_a_flat_likelihood_profile_keeps_the_best_color_inside_its_limits(monkeypatch):
    """The plot showed the light of another colour, at a quarter of the measured light."""

    def curve(roughness, color, score):
        return fitting._Curve(roughness=roughness, score=score, color=color, scale=1.0, scatter=0.1)

    def flat(model, kind, roughness, color):
        return curve(roughness, color, 0.01 * (0.8 - color))

    monkeypatch.setattr(fitting, "_best_at", flat)
    curves = [curve(0.3, 0.4, -3.0), curve(0.4, 0.8, 0.0), curve(0.5, 0.3, -3.0)]
    unused = SurfaceModel.__new__(SurfaceModel)
    value = fitting._color_interval(unused, "metal", curves)
    assert value.value == 0.8
    assert (value.low, value.high) == pytest.approx((0.2, 1.0), abs=0.003)


def test_too_few_pixels_are_refused():
    with pytest.raises(GraycastError, match="only 40 pixels have a depth"):
        fit_material(heap(40, widest_rad=0.5, seed=0), scale=None, seed=0)


def test_the_scale_follows_from_a_white_sheet_by_lamberts_law():
    white = heap(500, widest_rad=0.4, seed=0)
    light = SCALE * 0.8 / math.pi * white.light_cosine
    changed = {name: getattr(white, name) for name in white.__slots__} | {"light": light}
    assert scale_of(Reflections(**changed), 0.8) == pytest.approx(SCALE)
    with pytest.raises(GraycastError, match="only 50 pixels of the white reference"):
        scale_of(white.part(np.arange(50)), 0.8)


def steel_fit(lead):
    interval = fitting.FittedValue(value=0.4, low=0.38, high=0.43)
    return fitting.MaterialFit(
        kind="metal", color=interval, roughness=interval, scale=1.0, known=True, scatter=0.05,
        lead=lead, pixels=1000, angles_rad=(0.1, 0.5),
    )  # fmt: skip


def test_the_result_is_printed_as_a_material_section_with_the_fitted_numbers(tmp_path):
    section = MaterialSection(**yaml.safe_load(material_text(steel_fit(10.0), "stack.yaml")))
    material = resolve_material(section, tmp_path)
    assert (material.metallic, material.roughness) == (1.0, 0.4)
    assert material.base_color == (0.4,) * 3


def test_a_new_cell_takes_no_material_whose_kind_is_not_determined(tmp_path):
    path = tmp_path / "material.yaml"
    path.write_text(material_text(steel_fit(lead=1.0), "stack.yaml"))
    with pytest.raises(ConfigError, match="has no metallic, so the scan did not"):
        fitted_surface(path)
    path.write_text(material_text(steel_fit(lead=10.0), "stack.yaml"))
    assert fitted_surface(path).material == steel_fit(lead=10.0).material
