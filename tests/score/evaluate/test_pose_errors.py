"""Pose errors as defined by BOP, against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.base.frames import rigid
from graycast.rig.optics import Optics
from graycast.score.evaluate import mspd, mssd, rotation_translation, vsd
from graycast.world.parts import Symmetry
from graycast.world.parts.symmetry import motions

CAMERA = Optics(width_px=320, height_px=240, fx_px=400.0, fy_px=500.0, cx_px=160.0, cy_px=120.0)
ALONE = motions(Symmetry())
ROUND = motions(Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),)))
HALF_TURN = motions(Symmetry(discrete=(np.diag([-1.0, -1.0, 1.0, 1.0]),)))
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.02
TRUE = rigid(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([0.05, -0.02, 0.8]))


def moved(T, rotvec=(0, 0, 0), shift=(0, 0, 0)):
    """Rotate a pose about the part's own origin, then shift it in the camera frame."""
    R = Rotation.from_rotvec(rotvec).as_matrix()
    return rigid(T[:3, :3] @ R, T[:3, 3] + np.array(shift))


def test_the_mssd_of_a_shifted_pose_is_the_shift():
    for shift in ([0, 0, 0.004], [0.003, -0.004, 0.012]):
        off = mssd(moved(TRUE, shift=shift), TRUE, CUBE, ALONE)
        assert off == pytest.approx(np.linalg.norm(shift), rel=1e-12)


def test_the_error_of_a_rotation_is_the_chord_of_the_farthest_vertex():
    """Oracle: 2 r sin(angle / 2), where r is the largest distance of a vertex from the axis."""
    angle = 0.4
    off = mssd(moved(TRUE, rotvec=[0, 0, angle]), TRUE, CUBE, ALONE)
    assert off == pytest.approx(2 * 0.02 * np.sqrt(2) * np.sin(angle / 2), rel=1e-12)


def test_a_rotation_about_the_axis_of_symmetry_is_no_error():
    """The error at any angle is at most half a step of the discretised symmetry."""
    ring = np.array([[0.03 * np.cos(a), 0.03 * np.sin(a), 0.0] for a in np.arange(0, 6.28, 0.05)])
    off = mssd(moved(TRUE, rotvec=[0, 0, 1.234]), TRUE, ring, ROUND)
    assert off <= 0.03 * np.pi / 315
    assert mssd(moved(TRUE, rotvec=[0, 0, 1.234]), TRUE, ring, ALONE) > 0.03
    angle, shift = rotation_translation(moved(TRUE, rotvec=[0, 0, 1.234]), TRUE, ROUND)
    assert angle <= np.pi / 315 and shift < 1e-12


def test_a_half_turn_is_an_error_unless_the_part_has_that_symmetry():
    turned = moved(TRUE, rotvec=[0, 0, np.pi], shift=[0, 0, 0.001])
    assert mssd(turned, TRUE, CUBE, HALF_TURN) == pytest.approx(0.001, rel=1e-9)
    assert rotation_translation(turned, TRUE, HALF_TURN) == pytest.approx((0, 0.001), abs=1e-9)
    assert rotation_translation(turned, TRUE, ALONE)[0] == pytest.approx(np.pi)


def test_small_angles_are_measured_exactly():
    angle = 1e-6
    off = rotation_translation(moved(TRUE, rotvec=[0, angle, 0]), TRUE, ALONE)[0]
    assert off == pytest.approx(angle, rel=1e-6)


def test_the_mspd_of_a_sideways_shift_is_scaled_by_focal_length_over_depth():
    """Oracle for one vertex at depth z: f t / z pixels, scaled from 320 to 640 columns."""
    point, T = np.zeros((1, 3)), rigid(np.eye(3), np.array([0.0, 0.0, 0.8]))
    for shift, f_px in (([0.004, 0, 0], 400.0), ([0, 0.004, 0], 500.0)):
        off = mspd(moved(T, shift=shift), T, point, ALONE, CAMERA)
        assert off == pytest.approx(f_px * 0.004 / 0.8 * 640 / 320, rel=1e-12)


def test_a_shift_along_the_ray_has_no_mspd_in_the_middle_of_the_picture():
    point, T = np.zeros((1, 3)), rigid(np.eye(3), np.array([0.0, 0.0, 0.8]))
    assert mspd(moved(T, shift=[0, 0, 0.1]), T, point, ALONE, CAMERA) == pytest.approx(0)
    behind = rigid(np.eye(3), np.array([0.0, 0.0, -0.8]))
    assert mspd(behind, T, point, ALONE, CAMERA) == np.inf


def test_mspd_is_the_minimum_over_symmetries_of_the_maximum_over_vertices():
    """Oracle: the definition in plain NumPy, without early termination."""
    estimate = moved(TRUE, rotvec=[0.1, 0.2, 2.9], shift=[0.002, 0.001, 0.01])
    focal, middle = [400.0, 500.0], [160.0, 120.0]

    def pixels(T):
        p = CUBE @ T[:3, :3].T + T[:3, 3]
        return p[:, :2] / p[:, 2:] * focal + middle

    far = [np.linalg.norm(pixels(estimate) - pixels(TRUE @ S), axis=1).max() for S in HALF_TURN]
    assert mspd(estimate, TRUE, CUBE, HALF_TURN, CAMERA) == pytest.approx(2 * min(far), rel=1e-12)
    apart = [
        np.linalg.norm((CUBE @ estimate[:3, :3].T + estimate[:3, 3])
                       - (CUBE @ (TRUE @ S)[:3, :3].T + (TRUE @ S)[:3, 3]), axis=1).max()
        for S in HALF_TURN
    ]  # fmt: skip
    assert mssd(estimate, TRUE, CUBE, HALF_TURN) == pytest.approx(min(apart), rel=1e-12)


# --- VSD ------------------------------------------------------------------------------------------

TAUS = np.array([0.005, 0.010, 0.020])


def surface(rows, z, shape=(10, 10)):
    """Return a distance map with one distance in some rows, and NaN elsewhere."""
    depth_m = np.full(shape, np.nan)
    depth_m[rows] = z
    return depth_m


def test_vsd_counts_pixels_of_only_one_pose_and_pixels_with_too_different_distances():
    """The truth has rows 0 to 5; the estimate has rows 2 to 7, 12 mm farther; they share 4 of 8."""
    true, estimate = surface(np.s_[0:6], 0.8), surface(np.s_[2:8], 0.812)
    floor = np.full((10, 10), np.nan)  # Without a measurement, all surfaces are visible.
    np.testing.assert_allclose(vsd(estimate, true, floor, TAUS), [1, 1, 0.5])


def test_vsd_equal_to_the_tolerance_is_an_error():
    true, estimate = surface(np.s_[:], 0.75), surface(np.s_[:], 0.875)
    np.testing.assert_array_equal(vsd(estimate, true, true, np.array([0.125, 0.126])), [1, 0])


def test_vsd_ignores_hidden_pixels():
    """Rows 0 and 1 are hidden by a surface 16 mm in front of them, but not by one at 14 mm."""
    true = surface(np.s_[0:4], 0.8)
    estimate = surface(np.s_[2:4], 0.8)
    for gap, error in ((0.016, 0.0), (0.014, 0.5)):
        measured = np.full((10, 10), 0.8)
        measured[:2] = 0.8 - gap
        np.testing.assert_allclose(vsd(estimate, true, measured, TAUS), error)


def test_a_part_in_front_of_the_measured_surface_is_visible():
    """The true part is not there; the estimate is 100 mm in front of the measured surface."""
    true, estimate = surface(np.s_[0:0], 0.8), surface(np.s_[0:4], 0.7)
    np.testing.assert_array_equal(vsd(estimate, true, np.full((10, 10), 0.8), TAUS), 1)
    shared = surface(np.s_[0:2], 0.7)
    np.testing.assert_allclose(vsd(estimate, shared, np.full((10, 10), 0.8), TAUS), 0.5)


def test_an_estimate_behind_the_measured_surface_is_visible_at_pixels_of_the_true_part():
    """In BOP, the visibility mask of the estimate includes the true part's visible pixels."""
    true, estimate = surface(np.s_[0:4], 0.8), surface(np.s_[0:4], 0.83)
    error = vsd(estimate, true, np.full((10, 10), 0.8), np.array([0.02, 0.04]))
    np.testing.assert_array_equal(error, [1, 0])
    elsewhere = surface(np.s_[6:10], 0.83)  # It is hidden by the measured surface, so not counted.
    combined = np.where(np.isfinite(true), true, elsewhere)
    np.testing.assert_array_equal(vsd(combined, true, np.full((10, 10), 0.8), TAUS), [0, 0, 0])


def test_the_error_is_one_if_no_pixel_is_visible():
    nothing = np.full((10, 10), np.nan)
    np.testing.assert_array_equal(vsd(nothing, nothing, nothing, TAUS), [1, 1, 1])
