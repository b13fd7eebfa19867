"""A bin whose floor has another material than its walls."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.base.color import linear, srgb
from graycast.real.fit_bin.look import recolored
from graycast.rendering import Quality
from graycast.rendering.wavelength import at_one_wavelength, at_projector_wavelength
from graycast.rig.pair import preset_rig
from graycast.world.parts import Material, material_preset
from graycast.world.scene import EMPTY_LAYOUT, Bin, Environment, Scene, bin_mesh, bin_surfaces

WALLS = Material(base_color=(0.6, 0.3, 0.1), projector_reflectance=0.5)
FLOOR = Material(base_color=(0.1, 0.3, 0.6), projector_reflectance=0.2)
SIZE_M = (0.4, 0.3, 0.15)


def test_a_bin_with_one_material_is_a_single_mesh():
    box = Bin(inner_m=SIZE_M, material=WALLS)
    ((name, mesh, material),) = bin_surfaces(box)
    assert (name, material) == ("bin", WALLS)
    whole = bin_mesh(box)
    for array in ("vertices_m", "faces", "corner_uv"):
        assert np.array_equal(getattr(mesh, array), getattr(whole, array))


def test_the_inner_rectangle_at_height_0_is_the_floor_and_the_rest_is_walls():
    box = Bin(inner_m=SIZE_M, material=WALLS, floor=FLOOR)
    (_, walls, material), (_, floor, own) = bin_surfaces(box)
    assert (material, own) == (WALLS, FLOOR)
    corner = floor.vertices_m[floor.faces]
    assert (corner[..., 2] == 0).all()
    area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert area.sum(axis=0) == pytest.approx([0, 0, 0.4 * 0.3])  # All faces of the floor point up.
    assert len(walls.faces) + len(floor.faces) == len(bin_mesh(box).faces)
    others = {tuple(face) for face in walls.faces.tolist()}
    assert not others & {tuple(face) for face in floor.faces.tolist()}


def scene(**words):
    return Scene(
        rig=preset_rig("like-phoxi-m"), T_world_cam=np.eye(4), bin=Bin(inner_m=SIZE_M, **words)
    )


def test_the_floor_has_its_own_reflectance_in_projector_light():
    gray = at_projector_wavelength(scene(material=WALLS, floor=FLOOR))
    assert gray.bin.floor.base_color == (0.2, 0.2, 0.2)
    assert gray.bin.material.base_color == (0.5, 0.5, 0.5)
    only_floor = at_projector_wavelength(scene(floor=FLOOR))
    assert only_floor.bin.floor.base_color == (0.2, 0.2, 0.2)
    red = at_one_wavelength(scene(material=WALLS, floor=FLOOR))
    assert red.bin.floor.base_color == (0.1, 0.1, 0.1)


def test_a_colour_is_unchanged_by_encoding_and_decoding():
    every = np.arange(256, dtype=np.uint8)
    assert np.array_equal(srgb(linear(every)), every)
    assert linear(np.array([188], dtype=np.uint8))[0] == pytest.approx(0.5, abs=0.005)


@pytest.mark.slow
def test_a_floor_with_the_material_of_the_walls_does_not_change_the_light(mitsuba_renderer):
    """The paths and their light are the same, up to rounding of float32."""
    plain, split = (_rendered(mitsuba_renderer, floor) for floor in (None, WALLS))
    for name in ("white", "ambient", "white_rgb"):
        one, other = (getattr(r.radiance, name) for r in (plain, split))
        assert np.abs(one - other).max() <= 1e-4 * one.max(), name


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["mitsuba", "cycles"])
def test_both_renderers_show_the_floor_in_its_own_colour(backend, request):
    """In direct light, the radiance of a matt floor in each band is its reflectance."""
    renderer = request.getfixturevalue(f"{backend}_renderer")
    floor = Material(base_color=(0.1, 0.3, 0.6), specular=0.0)
    rendering = _rendered(renderer, floor, depth=1)
    depth_m = rendering.truth.depth_m
    middle = rendering.radiance.ambient_rgb[28:36, 36:44].reshape(-1, 3).mean(axis=0)
    assert depth_m[32, 40] == pytest.approx(0.9, abs=1e-4)
    assert middle / middle.sum() == pytest.approx([0.1, 0.3, 0.6], rel=1e-3)


def _rendered(renderer, floor, depth=4):
    rig = preset_rig("paper")
    camera = replace(rig.camera, width_px=80, height_px=64, fx_px=88.0, fy_px=88.0)
    rig = replace(rig, camera=replace(camera, cx_px=39.5, cy_px=31.5))
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 0.9
    walls = Material(base_color=WALLS.base_color)
    world = Scene(
        rig=rig,
        T_world_cam=T,
        bin=Bin(inner_m=SIZE_M, material=walls, floor=walls if floor is WALLS else floor),
        environment=Environment(radiance=(1.0, 1.0, 1.0)),
    )
    nothing = np.zeros((0, rig.projector.height_px, rig.projector.width_px), dtype=np.uint8)
    quality = Quality(samples=16, depth=depth)
    return renderer.render(world, EMPTY_LAYOUT, nothing, quality=quality, seed=3)


def test_a_mottled_material_accepts_the_brightest_colour_of_a_fit():
    """Symptom: a step of the fit raised an error, because mottle limits the colour."""
    blasted = material_preset("aluminium-blasted").material
    white = recolored(blasted, (0.98, 0.98, 0.98))
    assert (white.base_color, white.diffuse) == ((0.98, 0.98, 0.98), blasted.diffuse)
