"""The measuring camera sees all surfaces as greys in one narrow line of the spectrum."""

from dataclasses import replace

import numpy as np
import pytest
from stage import box_part, make_rig, optics

from graycast.rendering.wavelength import at_one_wavelength, at_projector_wavelength
from graycast.world.parts import Material
from graycast.world.scene import Bin, Quad, Scene

PICTURE = np.random.default_rng(2).integers(0, 256, (4, 4, 3), dtype=np.uint8)
PLACES = ("part", "surface", "table", "walls", "floor")


def scene_of(**materials):
    """Return a scene with this material in one place, and elsewhere a red without a line value."""
    red = Material(base_color=(0.6, 0.2, 0.1))
    by_place = dict.fromkeys(PLACES, red) | materials
    return Scene(
        rig=make_rig(optics(64, 48, 50), optics(32, 24, 30), band_weights=(1.0, 0.0, 0.0)),
        T_world_cam=np.eye(4),
        parts=(box_part(np.array([0.02, 0.02, 0.02]), by_place["part"]),),
        surfaces=(
            Quad(
                center_m=(0.0, 0.0, 0.4),
                half_u_m=(0.1, 0.0, 0.0),
                half_v_m=(0.0, 0.1, 0.0),
                material=by_place["surface"],
            ),
        ),
        table=by_place["table"],
        bin=Bin(inner_m=(0.4, 0.3, 0.1), material=by_place["walls"], floor=by_place["floor"]),
    )


def materials_of(scene):
    return {
        "part": scene.parts[0].material,
        "surface": scene.surfaces[0].material,
        "table": scene.table,
        "walls": scene.bin.material,
        "floor": scene.bin.floor,
    }


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("texture", [None, PICTURE])
def test_a_reflectance_at_the_projector_line_replaces_colour_and_texture(place, texture):
    known = Material(base_color=(0.9, 0.8, 0.7), texture=texture, projector_reflectance=0.3)
    scene = scene_of(**{place: known})
    before, after = (materials_of(one) for one in (scene, at_projector_wavelength(scene)))
    assert after[place].base_color == (0.3, 0.3, 0.3) and after[place].texture is None
    for other in set(PLACES) - {place}:
        assert after[other] is before[other]


def test_a_scene_without_a_projector_reflectance_is_returned_unchanged():
    scene = scene_of()
    assert at_projector_wavelength(scene) is scene


@pytest.mark.parametrize("place", PLACES)
def test_with_one_projector_band_surfaces_become_grey_at_that_band(place):
    pictured = Material(base_color=(0.9, 0.8, 0.7), texture=PICTURE)
    after = materials_of(at_one_wavelength(scene_of(**{place: pictured})))
    assert np.array_equal(after[place].texture, np.repeat(PICTURE[..., :1], 3, axis=-1))
    for other in set(PLACES) - {place}:
        assert after[other].base_color == (0.6, 0.6, 0.6)


def test_a_colour_is_refused_as_one_wavelength_if_the_projector_has_two_bands():
    scene = scene_of()
    scene = replace(scene, rig=replace(scene.rig, band_weights=(0.5, 0.5, 0.0)))
    with pytest.raises(ValueError, match="shines in 2 bands, and a material has the colour"):
        at_one_wavelength(scene)
