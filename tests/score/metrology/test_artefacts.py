"""Artefacts are at places that both devices see."""

import math

import numpy as np
import pytest
from stage import centred, make_rig, turned

from graycast.rig.pair import PRESETS, preset_rig
from graycast.score.metrology.artefacts import (
    ball_bars,
    clear,
    common_rectangle_m,
    grouped,
    plane,
    sphere_centre_m,
    sphere_fits,
    working_volume,
)
from graycast.world.parts import Material

GREY = Material()


def test_the_common_rectangle_of_parallel_devices_is_the_overlap_of_their_views():
    """Two equal pinholes are 0.2 m apart. At z, each covers z (w - 5) / f, since the field ends two
    pixels inside the outer centres. The overlap is 0.2 m narrower.
    """
    rig = make_rig(centred(200, 100, 200), centred(200, 100, 200), baseline_m=(0.2, 0.0, 0.0))
    low, high = common_rectangle_m(rig, 2.0)
    width, height = 2.0 * 195 / 200, 2.0 * 95 / 200
    grid_step = width / 60
    assert np.abs(high - low - [width - 0.2, height]).max() < 2 * grid_step
    assert abs((high + low)[0] / 2 - 0.1) < grid_step
    assert common_rectangle_m(rig, 0.2) is None


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.slow
def test_all_artefacts_of_a_preset_are_in_the_fields_of_camera_and_projector(name):
    rig = preset_rig(name)
    volume = working_volume(rig)
    radius_m = 0.03 * volume.diagonal_m
    for u in (-1.0, 1.0):
        for w in (0.0, 0.5, 1.0):
            centre = sphere_centre_m(rig, volume, (u, -u, w), radius_m)
            assert sphere_fits(rig, volume, centre, radius_m)
    bars = ball_bars(rig, volume, radius_m=0.5 * radius_m)
    assert len(bars) == 7
    assert np.ptp([bar.length_m for bar in bars]) < 1e-12
    # The pictures of the other rigs are wider, which leaves less space.
    least = 0.3 if name == "paper" or "phoxi" in name else 0.25
    assert bars[0].length_m > least * volume.diagonal_m
    assert all(clear(rig, bar.ends_m, bar.radius_m) for bar in bars)


def test_devices_without_a_common_field_of_view_have_no_working_volume():
    rig = make_rig(
        centred(64, 48, 80), centred(64, 48, 80), rotation=turned(0.0, math.radians(90), 0.0)
    )
    with pytest.raises(ValueError, match="no common field"):
        working_volume(rig)


@pytest.mark.slow
def test_a_sphere_too_large_for_the_volume_is_refused():
    rig = preset_rig("like-phoxi-s")
    with pytest.raises(ValueError, match="does not fit"):
        sphere_centre_m(rig, working_volume(rig), (0.0, 0.0, 0.5), 0.2)


def test_a_sphere_in_the_shadow_of_another_sphere_is_not_clearly_visible():
    """The camera sees both spheres, but one of them hides the other from the projector."""
    rig = make_rig(centred(64, 48, 80), centred(64, 48, 80), baseline_m=(0.3, 0.0, 0.0))
    projector = np.array([0.3, 0.0, 0.0])
    pair = projector + np.outer([1.0, 1.5], [-0.2, 0.1, 1.0])
    assert not clear(rig, pair, 0.02)
    assert clear(rig, pair + np.outer([0, 1], [0.0, -0.3, 0.0]), 0.02)
    assert not clear(rig, np.array([[0.1, 0.1, 1.0], [0.2, 0.2, 2.0]]), 0.02)  # hidden from camera


def test_spheres_share_a_scene_only_if_they_are_apart_at_the_same_depth():
    rig = make_rig(centred(64, 48, 80), centred(64, 48, 80))
    centre = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.03, 0.0, 1.0], [-0.3, 0.0, 2.0]])
    assert grouped(rig, centre, 0.02) == [[0, 1], [2], [3]]


@pytest.mark.parametrize("azimuth", [0.0, 0.7, 2.0])
def test_a_tilted_plane_has_its_angle_to_the_camera(azimuth):
    surface = plane(1.3, tilt_rad=0.5, azimuth_rad=azimuth, material=GREY)
    normal = np.cross(surface.half_u_m, surface.half_v_m)
    normal /= np.linalg.norm(normal)
    assert abs(normal[2] + math.cos(0.5)) < 1e-12
    assert abs(normal @ [math.cos(azimuth), math.sin(azimuth), 0.0]) < 1e-12
    assert surface.center_m == (0.0, 0.0, 1.3)
