"""Camera rays and pixels, with OpenCV as the independent program."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from graycast.rig.optics import (
    Optics,
    blur_radius_px,
    distort,
    fold_radius2,
    project,
    rays,
    relative_illumination,
    undistort,
)

# Coefficients of a real camera (wide angle, barrel) and of a real projector with a large k3.
CAMERA = Optics(
    width_px=2592, height_px=1944, fx_px=2821.4, fy_px=2818.9, cx_px=1506.8, cy_px=1092.3,
    distortion=(-0.2314, 0.1473, -0.00088, 0.00128, -0.0321),
)  # fmt: skip
PROJECTOR = Optics(
    width_px=1280, height_px=800, fx_px=1653.2, fy_px=1719.2, cx_px=622.4, cy_px=363.5,
    distortion=(-0.0486, 1.4234, -0.00751, -0.00198, -7.3646),
)  # fmt: skip
PLAIN = Optics(width_px=640, height_px=480, fx_px=800.0, fy_px=600.0, cx_px=319.5, cy_px=200.0)
ALL = pytest.mark.parametrize("optics", [CAMERA, PROJECTOR, PLAIN], ids=["camera", "beam", "plain"])


def pixels_all_over(optics, n=25):
    x = np.linspace(-0.5, optics.width_px - 0.5, n)
    y = np.linspace(-0.5, optics.height_px - 0.5, n)
    return np.stack(np.meshgrid(x, y), axis=-1)


def points_in_view(optics, seed=0):
    """Return ideal points drawn uniformly from the undistorted field, at random depths."""
    rng = np.random.default_rng(seed)
    reach = np.array([optics.width_px / optics.fx_px, optics.height_px / optics.fy_px]) / 2
    z = rng.uniform(0.2, 3.0, size=(200, 1))
    return np.hstack([rng.uniform(-reach, reach, size=(200, 2)) * z, z])


@ALL
def test_projected_points_agree_with_opencv(optics):
    point = points_in_view(optics)
    expected, _ = cv2.projectPoints(
        point, np.zeros(3), np.zeros(3), optics.K, np.array(optics.distortion)
    )
    assert np.abs(project(optics, point) - expected[:, 0]).max() < 1e-8


@ALL
def test_rays_of_pixels_agree_with_opencv(optics):
    """OpenCV's fixed-point iteration has enough rounds to converge to 1e-12."""
    pixel = pixels_all_over(optics)
    ideal = cv2.undistortPoints(
        pixel.reshape(-1, 1, 2), optics.K, np.array(optics.distortion), None, None, None,
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 500, 1e-13),
    )  # fmt: skip
    ray = rays(optics, pixel)
    assert np.abs(ray[..., :2].reshape(-1, 2) - ideal.reshape(-1, 2)).max() < 1e-9
    assert (ray[..., 2] == 1).all()


@ALL
def test_the_ray_of_every_pixel_is_projected_back_to_that_pixel(optics):
    pixel = pixels_all_over(optics)
    distance = np.random.default_rng(1).uniform(0.1, 5, size=(*pixel.shape[:2], 1))
    assert np.abs(project(optics, rays(optics, pixel) * distance) - pixel).max() < 1e-6


def test_a_point_is_projected_to_the_pixel_computed_by_hand():
    """Computed by hand: 800 * 0.1 / 2 + 319.5 and 600 * (-0.2) / 2 + 200."""
    assert project(PLAIN, np.array([0.1, -0.2, 2.0])).tolist() == [359.5, 140.0]


def test_each_distortion_coefficient_acts_as_in_brown_s_model():
    """Computed by hand at (x, y) = (0.2, 0.1), r2 = 0.05."""
    point, unit = np.array([0.2, 0.1]), np.eye(5)
    moved = [distort(point, tuple(row)) - point for row in unit]
    expected = [
        [0.2 * 0.05, 0.1 * 0.05],
        [0.2 * 0.05**2, 0.1 * 0.05**2],
        [2 * 0.02, 0.05 + 2 * 0.01],
        [0.05 + 2 * 0.04, 2 * 0.02],
        [0.2 * 0.05**3, 0.1 * 0.05**3],
    ]
    assert np.allclose(moved, expected, rtol=0, atol=1e-16)


def test_a_point_behind_the_lens_is_not_projected():
    assert np.isnan(project(PLAIN, np.array([[0.0, 0, -1], [0, 0, 0]]))).all()


def test_a_point_far_outside_the_field_is_not_folded_back_into_the_image():
    """Symptom: r2 = 0.59 makes the radial factor about 0, which is the middle of the projector."""
    point = np.array([math.sqrt(0.59), 0.0, 1.0])
    folded = distort(point[:2], PROJECTOR.distortion) * PROJECTOR.fx_px
    assert np.abs(folded).max() < 200  # the polynomial alone moves it to the centre
    assert np.isnan(project(PROJECTOR, point)).all()


@pytest.mark.parametrize("optics", [CAMERA, PROJECTOR], ids=["camera", "beam"])
def test_a_lens_folds_over_where_its_distorted_radius_stops_growing(optics):
    """Oracle: the first maximum of r * radial(r^2) on a fine grid."""
    k1, k2, _, _, k3 = optics.distortion
    r = np.linspace(0, 3, 300_001)
    distorted = r * (1 + k1 * r**2 + k2 * r**4 + k3 * r**6)
    first = np.argmax(np.diff(distorted) < 0)
    assert math.sqrt(fold_radius2(optics.distortion)) == pytest.approx(r[first], abs=2e-5)


def test_a_lens_whose_distortion_only_stretches_has_no_fold():
    assert fold_radius2((0.1, 0.2, 0.0, 0.0, 0.0)) == math.inf
    assert fold_radius2((0.0, 0.0, 0.01, 0.01, 0.0)) == math.inf
    assert fold_radius2((-1 / 3, 0.0, 0.0, 0.0, 0.0)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "distortion", [(-1.5, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, -1e6), (1e200,) + (0.0,) * 4]
)
def test_distortion_that_folds_over_inside_the_image_is_refused(distortion):
    with pytest.raises(ValueError, match="no inverse over this image"):
        undistort(np.array([[0.5, 0.5], [0.0, 0.0]]), distortion)


def test_the_field_of_view_extends_from_border_to_border_of_the_picture():
    """In a 90 degree lens, half the width equals the focal length."""
    optics = Optics(width_px=200, height_px=100, fx_px=100.0, fy_px=50.0, cx_px=99.5, cy_px=49.5)
    assert np.degrees(optics.field_of_view_rad) == pytest.approx([90, 90])


@pytest.mark.parametrize("z_m", [0.3, 0.8, 5.0])
def test_the_blur_disc_is_bounded_by_rays_from_the_rim_of_the_pupil(z_m):
    """The rays are lines through (+-A / 2, 0) and the point; a pixel is focus / fx wide there."""
    aperture_m, focus_m = 0.02, 0.5
    lens = replace(PLAIN, aperture_m=aperture_m, focus_m=focus_m)
    rim = np.array([-aperture_m / 2, aperture_m / 2])
    x = rim + (0.03 - rim) * focus_m / z_m
    expected = abs(np.diff(x)[0]) / 2 * PLAIN.fx_px / focus_m
    assert blur_radius_px(lens, np.array([z_m]))[0] == pytest.approx(expected, rel=1e-12)


def test_the_squares_of_blur_radii_add_up():
    """Oracle: hypot(2, 1.5); at 0.5 / 0.875 m, 0.02 / 2 (1 / 0.5 - 1 / z) 800 px is 2 px."""
    lens = replace(PLAIN, aperture_m=0.02, focus_m=0.5, psf_px=1.5)
    assert PLAIN.fx_px == 800.0
    assert blur_radius_px(lens, np.array([0.5 / 0.875]))[0] == pytest.approx(2.5, rel=1e-12)


def test_a_focused_lens_and_a_pinhole_have_only_the_constant_blur():
    lens = replace(PLAIN, aperture_m=0.02, focus_m=0.5, psf_px=1.2)
    assert blur_radius_px(lens, np.array([0.5]))[0] == pytest.approx(1.2)
    assert blur_radius_px(replace(lens, aperture_m=0.0), np.array([0.1, 9.0])) == pytest.approx(1.2)
    assert PLAIN.is_pinhole and not lens.is_pinhole
    far = replace(PLAIN, aperture_m=0.02)  # focused at infinity: the pupil's own image
    assert blur_radius_px(far, np.array([2.0]))[0] == pytest.approx(0.01 / 2 * 800)


def test_a_camera_dims_light_by_the_fourth_power_of_the_cosine():
    """At 45 degrees to the axis a quarter of the light is left; on the axis, all of it."""
    lens = Optics(width_px=101, height_px=1, fx_px=100.0, fy_px=100.0, cx_px=0.0, cy_px=0.0)
    assert (relative_illumination(lens) == 1).all()
    light = relative_illumination(replace(lens, natural_vignetting=True))
    assert light[0, [0, 100]] == pytest.approx([1.0, 0.25])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width_px": 0}, "width_px is 0: it should be greater"),
        ({"fy_px": -600.0}, "fy_px is -600.0: it should be greater than 0"),
        ({"fx_px": math.nan}, "fx_px is nan: it should be a finite number"),
        ({"cx_px": math.inf}, "cx_px is inf: it should be a finite number"),
        ({"distortion": (0.0, 0.0, math.nan, 0.0, 0.0)}, "distortion is .*finite number"),
        ({"aperture_m": -0.001}, "aperture_m is -0.001"),
        (
            {"aperture_m": 7.2},
            "a pupil's diameter must be less than 1 m: give it in metres, not in",
        ),
        ({"focus_m": 0.0}, "focus_m is 0.0"),
        ({"focus_m": math.nan}, "focus_m is nan"),
        ({"psf_px": math.inf}, "psf_px is inf"),
        ({"fill_factor": 0.0}, "fill_factor is 0.0"),
        ({"fill_factor": 1.1}, "fill_factor is 1.1"),
    ],
)
def test_impossible_values_of_a_lens_are_refused(change, message):
    good = {"width_px": 640, "height_px": 480, "fx_px": 8.0, "fy_px": 6.0, "cx_px": 3.0}
    with pytest.raises(ValueError, match=message):
        Optics(**(good | {"cy_px": 2.0} | change))
