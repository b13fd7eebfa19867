"""Rig presets, depth per column, and the placement of a rig above its target."""

import math
from dataclasses import replace

import numpy as np
import pytest

from graycast.base.frames import axis_rotation, inverse, is_rigid, rigid, transform_points
from graycast.rig.optics import Optics, project, rays
from graycast.rig.pair import (
    RESOLUTIONS,
    Rig,
    aimed,
    best_depth_m,
    depth_per_line_m,
    emission,
    grey_levels,
    place,
    preset_rig,
    standoff_m,
)

# baseline [m], toe-in of both axes [deg], range [m], and the camera's focal length at 2064 px
PHOXI = {
    "like-phoxi-s": (0.230, 15.45, 0.384, 0.520, 2246.0),
    "like-phoxi-m": (0.350, 11.75, 0.458, 1.118, 2269.0),
    "like-phoxi-l": (0.550, 9.45, 0.870, 2.150, 2263.0),
    "paper": (0.350, 11.75, 0.458, 1.118, 2269.0),
}
EVERY = pytest.mark.parametrize("name", PHOXI)


def parallel_rig(along, fx_px=900.0, baseline_m=0.2):
    """Return a projector beside (or below) the camera with parallel axes and a wide field."""
    optics = {"width_px": 801, "height_px": 601, "cx_px": 400.0, "cy_px": 300.0}
    T_cam_proj = np.eye(4)
    T_cam_proj["xy".index(along), 3] = baseline_m
    return Rig(
        name="parallel",
        camera=Optics(**optics, fx_px=700.0, fy_px=700.0),
        projector=Optics(**optics, fx_px=fx_px, fy_px=fx_px),
        T_cam_proj=T_cam_proj,
        near_m=0.6,
        far_m=2.0,
    )


@EVERY
def test_phoxi_presets_have_their_stated_values(name):
    baseline_m, toe_in_deg, near_m, far_m, fx_px = PHOXI[name]
    low, full = preset_rig(name), preset_rig(name, "full")
    assert low.baseline_m == pytest.approx(baseline_m)
    assert math.degrees(low.axes_angle_rad) == pytest.approx(2 * toe_in_deg)
    assert (low.near_m, low.far_m) == (near_m, far_m)
    assert (low.camera.width_px, low.camera.height_px) == (1032, 772)
    assert (full.camera.width_px, full.camera.height_px) == (2064, 1544)
    assert full.camera.fx_px == fx_px
    assert low.camera.field_of_view_rad == pytest.approx(full.camera.field_of_view_rad)
    assert np.degrees(low.projector.field_of_view_rad) == pytest.approx([47.5, 36.0])


@EVERY
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_the_optical_axes_of_a_preset_pass_through_the_middle_of_each_picture(name, resolution):
    """The outer corners of opposite corner pixels have opposite slopes."""
    rig = preset_rig(name, resolution)
    for lens in (rig.camera, rig.projector):
        corner = np.array([[-0.5, -0.5], [lens.width_px - 0.5, lens.height_px - 0.5]])
        slope = rays(lens, corner)[:, :2]
        np.testing.assert_allclose(slope[0], -slope[1], rtol=1e-12)


@EVERY
def test_the_axes_of_a_toed_in_rig_cross_inside_its_working_range(name):
    """Oracle: the isosceles triangle over the baseline, sides b / 2 / sin(toe-in)."""
    baseline_m, toe_in_deg, near_m, far_m, _ = PHOXI[name]
    crossing_m = baseline_m / 2 / math.sin(math.radians(toe_in_deg))
    rig = preset_rig(name)
    assert near_m < crossing_m < far_m
    assert standoff_m(rig) == pytest.approx(math.sqrt(crossing_m**2 - (baseline_m / 2) ** 2))
    assert best_depth_m(rig) == pytest.approx(crossing_m, rel=1e-12)
    meeting = np.array([[0.0, 0.0, crossing_m]])
    assert np.allclose(
        transform_points(inverse(rig.T_cam_proj), meeting), meeting, rtol=0, atol=1e-12
    )


def test_the_best_depth_is_inside_the_working_range_even_if_the_axes_cross_beyond_it():
    """The axes of this rig cross at 0.859 m."""
    rig = preset_rig("like-phoxi-m")
    assert best_depth_m(replace(rig, far_m=0.7)) == 0.7
    assert best_depth_m(replace(rig, near_m=1.0)) == 1.0


def test_the_best_depth_of_a_rig_with_parallel_axes_is_mid_range():
    assert best_depth_m(parallel_rig("x")) == pytest.approx(1.3)


@pytest.mark.parametrize("z_m", [0.7, 1.0, 1.7])
def test_depth_per_column_of_a_parallel_rig_follows_similar_triangles(z_m):
    """column = const - f b / z, so one column is z^2 / (f b) of depth."""
    assert depth_per_line_m(parallel_rig("x"), z_m, "column") == pytest.approx(
        z_m**2 / (900.0 * 0.2), rel=1e-7
    )


def test_depth_per_column_of_a_toed_in_rig_agrees_with_a_ray_of_the_next_column():
    """Oracle: near the crossing of the axes, a projector ray rotates by 1 / f per column.

    Both devices are equally far from the crossing: depth changes by distance / f / sin(angle).
    """
    rig = preset_rig("like-phoxi-m")
    z_m = best_depth_m(rig)
    expected = z_m / rig.projector.fx_px / math.sin(rig.axes_angle_rad)
    assert depth_per_line_m(rig, z_m, "column") == pytest.approx(expected, rel=1e-6)


def test_depth_per_column_is_nan_beyond_the_projector_s_picture():
    """The projector's edge is 400.5 columns from its middle: f b / z = 400.5 at z = 0.4494 m."""
    rig = parallel_rig("x")
    assert math.isnan(depth_per_line_m(rig, 0.449, "column"))
    assert not math.isnan(depth_per_line_m(rig, 0.450, "column"))


def test_columns_parallel_to_the_baseline_give_no_depth():
    assert depth_per_line_m(parallel_rig("y"), 1.0, "column") == math.inf
    assert depth_per_line_m(parallel_rig("x"), 1.0, "row") == math.inf


@pytest.mark.parametrize("z_m", [0.7, 1.0, 1.7])
def test_depth_per_row_with_a_vertical_baseline_follows_similar_triangles(z_m):
    """row = const - f b / z."""
    expected_m = z_m**2 / (900.0 * 0.2)
    assert depth_per_line_m(parallel_rig("y"), z_m, "row") == pytest.approx(expected_m, rel=1e-7)


@EVERY
@pytest.mark.parametrize("azimuth_rad", [0.0, 0.4, -2.0])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.3])
def test_a_placed_rig_has_the_stated_target_distance_and_tilt(name, azimuth_rad, tilt_rad):
    rig, target, distance_m = preset_rig(name), np.array([0.05, -0.1, 0.02]), 0.9
    T_world_cam = place(
        rig, target_m=target, distance_m=distance_m, tilt_rad=tilt_rad, azimuth_rad=azimuth_rad
    )
    assert is_rigid(T_world_cam)
    T_world_proj = T_world_cam @ rig.T_cam_proj
    camera, projector = T_world_cam[:3, 3], T_world_proj[:3, 3]
    middle, bisector = (camera + projector) / 2, T_world_cam[:3, 2] + T_world_proj[:3, 2]
    assert np.linalg.norm(middle - target) == pytest.approx(distance_m)
    bisector /= np.linalg.norm(bisector)
    assert np.allclose(middle + distance_m * bisector, target, rtol=0, atol=1e-12)
    assert math.acos(np.clip(-bisector[2], -1, 1)) == pytest.approx(tilt_rad, abs=1e-7)
    along = (projector - camera) / rig.baseline_m
    level = [math.cos(azimuth_rad), math.sin(azimuth_rad), 0]
    assert np.allclose(along, level, rtol=0, atol=1e-12)
    stands = [math.sin(azimuth_rad), -math.cos(azimuth_rad)]  # -y, rotated by the azimuth
    offset = distance_m * math.sin(tilt_rad)
    assert np.allclose(middle[:2] - target[:2], np.multiply(stands, offset), rtol=0, atol=1e-12)


def test_the_image_of_a_tilted_rig_has_its_y_axis_down():
    """The rig is at -y and looks to +y: higher points are higher in the picture."""
    rig = preset_rig("like-phoxi-m")
    T_world_cam = place(rig, target_m=np.zeros(3), distance_m=0.9, tilt_rad=0.5, azimuth_rad=0.0)
    above = transform_points(inverse(T_world_cam), np.array([[0.0, 0, 0], [0, 0, 0.1]]))
    y = above[:, 1] / above[:, 2]
    assert y[1] < y[0]
    assert T_world_cam[2, 1] < 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"near_m": 2.5}, "0 < near_m < far_m"),
        ({"T_cam_proj": np.eye(4)}, "give them a baseline"),
        ({"T_cam_proj": np.diag([1.0, 1, -1, 1])}, "not a rotation"),
        ({"intensity_w_sr": 0.0}, "intensity_w_sr is 0.0: it should be greater than 0"),
        ({"band_weights": (0.5, 0.5, 0.5)}, "whose sum is 1"),
        ({"picture_level": 1.5}, "picture_level is 1.5: it should be less than or equal to 1"),
    ],
)
def test_impossible_values_of_a_rig_are_refused(change, message):
    rig = parallel_rig("x")
    fields = {name: getattr(rig, name) for name in rig.__dataclass_fields__}
    with pytest.raises(ValueError, match=message):
        Rig(**(fields | change))


def test_a_baseline_in_millimetres_is_recognized_as_a_wrong_unit():
    with pytest.raises(ValueError, match="m: give T in metres, not in millimetres"):
        parallel_rig("x", baseline_m=230.0)


def test_the_error_for_an_unknown_preset_lists_the_presets():
    with pytest.raises(ValueError, match="paper, like-phoxi-s, like-phoxi-m, like-phoxi-l"):
        preset_rig("phoxi-z")
    with pytest.raises(ValueError, match="small, low, full"):
        preset_rig("paper", "medium")


LEVELS = np.arange(256, dtype=np.uint8)


def test_a_linear_projector_emits_in_proportion_to_the_grey_level():
    assert emission(parallel_rig("x"), LEVELS) == pytest.approx(LEVELS / 255, abs=1e-15)


def test_the_response_curve_is_linear_between_equally_spaced_values():
    """Computed by hand: knots at 0, 85, 170 and 255."""
    rig = replace(parallel_rig("x"), response=(0.0, 0.1, 0.4, 1.0))
    level = np.array([0, 17, 85, 170, 187, 255], dtype=np.uint8)
    assert emission(rig, level) == pytest.approx([0, 0.02, 0.1, 0.4, 0.52, 1.0])


@pytest.mark.parametrize("response", [(0.0, 1.0), (0.0, 0.1, 0.4, 1.0), (0.0, 0.9, 1.0)])
def test_a_share_of_light_is_shown_by_the_nearest_grey_level(response):
    """Oracle: a search over all levels."""
    rig = replace(parallel_rig("x"), response=response)
    assert (grey_levels(rig, emission(rig, LEVELS)) == LEVELS).all()
    share = np.random.default_rng(0).uniform(0, 1, (40, 50))
    miss = np.abs(emission(rig, LEVELS) - share[..., None])
    own_miss = np.take_along_axis(miss, grey_levels(rig, share)[..., None].astype(int), axis=-1)
    assert np.array_equal(own_miss[..., 0], miss.min(axis=-1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"response": (0.0,)}, "2 to 256 values"),
        ({"response": (0.0, 0.5, 0.5, 1.0)}, "each above the last"),
        ({"response": (0.0, math.nan, 1.0)}, "a finite number"),
        (
            {"response": (0.1, 1.0)},
            "it must start at 0 and end at 1, relative to white: state the light",
        ),
        (
            {"response": (0.0, 255.0)},
            "it must start at 0 and end at 1, relative to white: state the light",
        ),
        ({"contrast_ratio": 1.0}, "projector's white to its black"),
        ({"contrast_ratio": math.nan}, "projector's white to its black"),
        ({"veil": 1.0}, "veil is 1.0"),
        ({"speckle_contrast": -0.1}, "speckle_contrast is -0.1"),
    ],
)
def test_impossible_light_of_a_projector_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(parallel_rig("x"), **change)


# --- rigs of other baselines -------------------------------------------------------------------


def test_a_rig_given_another_baseline_is_aimed_at_the_target():
    """Oracle: both axes, as lines, pass through the point in front of the baseline's middle."""
    rig = aimed(preset_rig("like-phoxi-l", "small"), baseline_m=0.3, distance_m=1.2)
    assert rig.baseline_m == pytest.approx(0.3)
    assert rig.axes_angle_rad == pytest.approx(2 * np.arctan(0.15 / 1.2))
    middle = rig.T_cam_proj[:3, 3] / 2
    along = np.hypot(1.2, 0.15)
    crossing = transform_points(rig.T_cam_proj, np.array([0.0, 0.0, along]))
    np.testing.assert_allclose(crossing, [0, 0, along], atol=1e-12)
    assert np.linalg.norm(crossing - middle) == pytest.approx(1.2)


@pytest.mark.parametrize("name", ["like-phoxi-s", "like-phoxi-m", "like-phoxi-l"])
def test_aiming_a_rig_at_its_own_baseline_and_distance_changes_nothing(name):
    rig = preset_rig(name, "small")
    same = aimed(rig, baseline_m=rig.baseline_m, distance_m=standoff_m(rig))
    np.testing.assert_allclose(same.T_cam_proj, rig.T_cam_proj, atol=1e-9)


def test_a_projector_with_lens_shift_is_aimed_with_the_middle_of_its_picture():
    """Symptom: half of the bin was dark. The projector's axis goes through its picture's lowest
    row.

    Oracle: the target is in the middle of both pictures.
    """
    plain = parallel_rig("x")
    shifted = replace(plain, projector=replace(plain.projector, cy_px=600.0))
    rig = aimed(shifted, baseline_m=0.3, distance_m=0.9)
    assert standoff_m(rig) == pytest.approx(0.9)
    target = np.array([0.1, -0.2, 0.05])
    T = place(rig, target_m=target, distance_m=standoff_m(rig), tilt_rad=0.3, azimuth_rad=0.7)
    for optics, T_world in ((rig.camera, T), (rig.projector, T @ rig.T_cam_proj)):
        pixel = project(optics, transform_points(inverse(T_world), target))
        np.testing.assert_allclose(pixel, [400.0, 300.0], atol=1e-6)
    middle = transform_points(T, rig.T_cam_proj[:3, 3] / 2)
    assert np.linalg.norm(middle - target) == pytest.approx(0.9)


def test_aiming_a_projector_keeps_its_roll():
    """A projector that is rolled about its own axis keeps this roll."""
    rig = preset_rig("like-phoxi-m", "small")
    roll = rigid(axis_rotation("z", 0.3), np.zeros(3))
    rolled = replace(rig, T_cam_proj=rig.T_cam_proj @ roll)
    turned, plain = (aimed(r, baseline_m=0.2, distance_m=0.9).T_cam_proj for r in (rolled, rig))
    np.testing.assert_allclose(inverse(plain) @ turned, roll, atol=1e-9)
