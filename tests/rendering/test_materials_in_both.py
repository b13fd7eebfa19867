"""The same description of a material in Cycles and in our BSDFs: furnace and distant lamp."""

import json
import subprocess
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from graycast.world.parts import Grain, Material

pytestmark = pytest.mark.slow  # each render of Cycles takes some seconds

BANDS = (0.2, 0.5, 0.9)
LAMPS_DEG = [(0, 0), (30, 0), (30, 180), (45, 90), (60, 0), (60, 180), (75, 0), (75, 180)]
VIEWS_DEG = (0, 30, 60)
SAMPLES = 400_000
ROUGHNESS = (0.1, 0.3, 0.5, 0.8, 1.0)


@pytest.fixture(scope="module")
def in_cycles(tmp_path_factory):
    """Render a list of (material, view [deg], lamp [deg, deg] or None); return (n, 2, 3), mean and
    standard error.
    """
    from graycast.rendering.cycles.process import WORKER, find_cycles

    python = find_cycles()
    if python is None:
        pytest.skip("needs Blender Cycles, which is not here; run: make cycles")

    def render(cases):
        folder = tmp_path_factory.mktemp("furnace")
        (folder / "cases.json").write_text(json.dumps([in_words(*case) for case in cases]))
        script = Path(__file__).with_name("furnace_in_cycles.py")
        command = [python, script, WORKER, folder / "cases.json", folder / "answers.json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr[-2000:]
        return np.array(json.loads((folder / "answers.json").read_text()))

    return render


def in_words(material, view_deg, lamp_deg):
    names = ("base_color", "metallic", "roughness", "ior", "anisotropy", "diffuse")
    return {
        "words": {name: getattr(material, name) for name in names}
        | dict.fromkeys(("texture", "roughness_map", "radiance")),
        "view": np.radians(view_deg),
        "light": None if lamp_deg is None else np.radians(lamp_deg).tolist(),
    }


def in_mitsuba(material, view_deg, lamp_deg):
    """Return (2, 3), as Cycles does; a lamp has no noise."""
    import drjit as dr
    import mitsuba as mi

    from graycast.rendering.mitsuba.scene import _bsdf

    bsdf, context = mi.load_dict(_bsdf(material)), mi.BSDFContext()
    si = dr.zeros(mi.SurfaceInteraction3f, 1 if lamp_deg else SAMPLES)
    si.t, si.wi = 1.0, mi.Vector3f(*towards(view_deg))
    if lamp_deg is not None:
        value = np.array(bsdf.eval(context, si, mi.Vector3f(*towards(*lamp_deg)), True))[:, 0]
        return np.stack([value, 0 * value])
    rng = np.random.default_rng(7)
    one = mi.Float(rng.random(SAMPLES).astype("f4"))
    two = mi.Point2f(rng.random((2, SAMPLES)).astype("f4"))
    weight = np.array(bsdf.sample(context, si, one, two, True)[1], dtype=float)
    return np.stack([weight.mean(1), weight.std(1) / np.sqrt(SAMPLES)])


def towards(angle_deg, turn_deg=0):
    angle, turn = np.radians(angle_deg), np.radians(turn_deg)
    z = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    return z.tolist()


def compared(in_cycles, cases):
    """Return Cycles over ours (n, 3), and its standard error."""
    theirs, ours = in_cycles(cases), np.stack([in_mitsuba(*case) for case in cases])
    ratio = theirs[:, 0] / ours[:, 0]
    return ratio, ratio * np.hypot(theirs[:, 1] / theirs[:, 0], ours[:, 1] / ours[:, 0])


def with_words(**words):
    return Material(base_color=BANDS, **words)


def test_each_renderer_applies_material_keys_and_lambert_s_law(cpu_device, in_cycles):
    """Furnace and lamp; a metal and a plastic show that their descriptions are applied, too."""
    lambert = with_words(specular=0.0)
    lit = [with_words(metallic=1.0, roughness=0.4), with_words(roughness=0.5)]
    cases = [(lambert, 30, None), (lambert, 30, (60, 45)), *((one, 30, (45, 180)) for one in lit)]
    theirs = in_cycles(cases)[:, 0]
    assert np.abs(theirs[0] / BANDS - 1).max() < 1e-4
    assert np.abs(theirs[1] / (np.array(BANDS) / np.pi * 0.5) - 1).max() < 1e-4
    metal, plastic = (theirs[2 + k] / in_mitsuba(*cases[2 + k])[0] for k in range(2))
    assert np.abs(metal - 1).max() < 0.003
    assert np.abs(plastic - 1).max() < 0.03


def test_mitsuba_and_cycles_reflect_equally_from_metal(cpu_device, in_cycles):
    """The tolerance is 0.3 %: both implement one published model with their own tables."""
    lamps = [(0, 0), (40, 0), (40, 180), (60, 90), (80, 180)]
    cases = [
        (with_words(metallic=1.0, roughness=r), view, lamp)
        for r, view, lamp in product(ROUGHNESS, (0, 40, 70), [None, *lamps])
    ]
    ratio, error = compared(in_cycles, cases)
    assert error.max() < 0.0025
    assert (np.abs(ratio - 1) < 0.003 + 4 * error).all()


def test_grooves_have_the_same_shape_in_both_renderers(cpu_device, in_cycles):
    """Grooves along x are seen and lit from all sides. Cycles' compensation ignores grooves: its
    metal is darker by one factor for all lamps, in the brightest band by 0.2 % at roughness 0.2, 2
    % at 0.35 and 8 % at 0.5.
    """
    lamps = [(40, 0), (40, 70), (30, 180), (60, 90), (70, 200)]
    grooves = {"anisotropy": 0.8, "grain": Grain(axis=(1.0, 0, 0)), "metallic": 1.0}
    cases = [
        (with_words(roughness=r, **grooves), view, lamp)
        for r, view, lamp in product((0.2, 0.35, 0.5), (0, 40), [None, *lamps])
    ]
    ratio, error = compared(in_cycles, cases)
    assert error.max() < 0.0025
    ratio, error = ratio.reshape(6, 6, 3), error.reshape(6, 6, 3)
    assert (np.abs(ratio[:, 1:] / ratio[:, :1] - 1) < 0.002 + 4 * error[:, :1]).all()
    darker = (1 - ratio[:, 0, 2]).reshape(3, 2).max(axis=1)
    assert (np.abs(darker - [0.002, 0.02, 0.083]) < [0.002, 0.002, 0.003]).all()


def test_plastic_reflects_the_same_total_light_in_both_renderers(cpu_device, in_cycles):
    """In the furnace, a very rough coat of Cycles reflects 9 % more, as light that hits two of its
    facets returns; ours leaves it to the base. With a base of 0.2 that is 1 %.
    """
    cases = [
        (with_words(roughness=r, specular=s), view, None)
        for r, s, view in product(ROUGHNESS, (0.25, 0.5, 1.0), (0, 30, 60, 75))
    ]
    ratio, error = compared(in_cycles, cases)
    assert error.max() < 0.0025
    assert (np.abs(ratio - 1) < 0.015 + 4 * error).all()


def test_plastic_under_a_lamp_differs_between_renderers_by_at_most_6_percent(cpu_device, in_cycles):
    """Cycles has no factor `(1 - E(light)) / (1 - mean E)`: its base is darker under steep light
    and brighter under grazing light. Within 60 degrees that is 6 %, and 5 % from roughness 0.3 on.
    """
    cases = [
        (with_words(roughness=r), view, lamp)
        for r, view, lamp in product(ROUGHNESS, VIEWS_DEG, LAMPS_DEG)
    ]
    ratio, _ = compared(in_cycles, cases)
    rough = np.array([case[0].roughness for case in cases])
    steep = np.array([case[2][0] <= 60 for case in cases])
    assert (np.abs(ratio - 1)[steep] < 0.06).all()
    assert (np.abs(ratio - 1)[steep & (rough >= 0.3)] < 0.05).all()
    assert (np.abs(ratio - 1)[steep & (rough >= 0.5)] < 0.03).all()
    assert (ratio[~steep] < 1.22).all()


def test_half_metallic_material_is_an_equal_mixture_in_both_renderers(cpu_device, in_cycles):
    cases = [
        (with_words(metallic=0.4, roughness=r, specular=s), view, lamp)
        for r, s, view, lamp in product((0.3, 0.8), (0.0, 0.5), (0, 60), [None, (60, 180)])
    ]
    ratio, error = compared(in_cycles, cases)
    assert (np.abs(ratio - 1) < 0.03 + 4 * error).all()


def test_scattering_metal_reflects_equally_in_both_renderers(cpu_device, in_cycles):
    """Both add Lambert's law to one model of metal, so the limit is that of plain metal."""
    cases = [
        (with_words(metallic=1.0, roughness=r, diffuse=d), view, lamp)
        for r, d, view, lamp in product(
            (0.3, 0.6), (0.3, 1.0), (0, 40), [None, (40, 180), (60, 90)]
        )
    ]
    ratio, error = compared(in_cycles, cases)
    assert (np.abs(ratio - 1) < 0.003 + 4 * error).all()


def test_a_scattering_half_metal_reflects_equally_in_both_renderers(cpu_device, in_cycles):
    """The limit is that of a half metallic surface."""
    cases = [
        (with_words(metallic=0.4, roughness=0.4, diffuse=0.6), view, lamp)
        for view, lamp in product((0, 60), [None, (60, 180)])
    ]
    ratio, error = compared(in_cycles, cases)
    assert (np.abs(ratio - 1) < 0.03 + 4 * error).all()


def test_the_back_of_a_surface_reflects_nothing_in_both_renderers(cpu_device, in_cycles):
    metal = with_words(metallic=1.0)
    cases = [(metal, 150, None), (metal, 30, (150, 0)), (metal, 150, (120, 0))]
    assert (in_cycles(cases)[:, 0] == 0).all()
    assert all((in_mitsuba(*case)[0] == 0).all() for case in cases)
