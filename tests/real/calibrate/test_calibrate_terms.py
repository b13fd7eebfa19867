"""Radial terms of the distortion: only terms that the corners determine are fitted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.base.frames import inverse, rigid, transform_points
from graycast.real.calibrate.adjust import Observations, adjust, joined
from graycast.rig.optics import Optics, project

NOISE_PX = 0.08
SIZE = (1280, 1024)
NOTHING = np.zeros((2, 2))


def lens(focal_px, distortion):
    return Optics(
        width_px=SIZE[0],
        height_px=SIZE[1],
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=639.5,
        cy_px=511.5,
        distortion=distortion,
    )


def noisy(corners, rng):
    """Return the same corners with noise in each coordinate."""
    return replace(
        corners,
        camera_px=corners.camera_px + rng.normal(0, NOISE_PX, corners.camera_px.shape),
        projector_px=corners.projector_px + rng.normal(0, NOISE_PX, corners.camera_px.shape),
    )


def corners_of(
    camera, projector, *, depth_m, seed, per_camera_px=NOTHING, noise_px=NOISE_PX, code_px=NOISE_PX
):
    """Return corners of seven tilted boards in both devices, with noise.

    The projector position has the noise of the code and the noise of the camera's corner.
    """
    rng = np.random.default_rng(seed)
    T_cam_proj = rigid(Rotation.from_euler("y", -0.2).as_matrix(), np.array([0.15, 0.0, 0.0]))
    side_m = 0.75 * depth_m * SIZE[1] / camera.fx_px / 8
    x, y = np.meshgrid(np.arange(9) - 4.0, np.arange(9) - 4.0)
    board_m = side_m * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    parts = []
    for view in range(7):
        turn = Rotation.from_euler("xyz", rng.uniform(-0.5, 0.5, 3)).as_matrix()
        T_cam_board = rigid(turn, depth_m * np.array([*rng.uniform(-0.05, 0.05, 2), 1.0]))
        in_cam = transform_points(T_cam_board, board_m)
        in_proj = transform_points(inverse(T_cam_proj), in_cam)
        parts.append((np.full(81, view), board_m, project(camera, in_cam),
                      project(projector, in_proj)))  # fmt: skip
    view, point_m, camera_px, projector_px = (np.concatenate(p) for p in zip(*parts, strict=True))
    off_px = rng.normal(0, noise_px, camera_px.shape)
    own_px = rng.normal(0, code_px, camera_px.shape)
    return Observations(
        view=view,
        point_m=point_m,
        camera_px=camera_px + off_px,
        projector_px=projector_px + own_px + off_px @ per_camera_px.T,
        per_camera_px=np.tile(per_camera_px, (len(view), 1, 1)),
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_terms_that_a_long_lens_does_not_determine_are_left_out_with_a_note(seed):
    """With a field of 20 degrees, r^6 is below 1e-4, so k3 is undetermined; k1 is determined."""
    camera = projector = lens(3600.0, (-0.3, 0.0, 0.0, 0.0, 0.0))
    corners = corners_of(camera, projector, depth_m=0.8, seed=seed)
    fit = adjust(corners, SIZE, SIZE, radial_terms=3, tangential=True)
    for name, device in (("camera", fit.camera), ("projector", fit.projector)):
        value, sigma = fit.undetermined[f"{name}.k3"]
        assert abs(value) < 5 * sigma
        assert sigma > 1  # For example, k3 was -113 +- 34, which no lens has.
        assert device.distortion[4] == 0
        assert f"{name}.k3" not in fit.deviation
        assert abs(device.distortion[0] + 0.3) < 5 * fit.deviation[f"{name}.k1"]
    away = project(fit.camera, np.array([[0.15, 0.12, 0.9], [-0.15, -0.12, 0.9]]))
    true = project(camera, np.array([[0.15, 0.12, 0.9], [-0.15, -0.12, 0.9]]))
    assert np.abs(away - true).max() < 2.0  # at the corners of the picture


@pytest.mark.slow
def test_terms_that_a_wide_lens_determines_are_kept():
    camera = projector = lens(750.0, (-0.21, 0.13, -0.0009, 0.0012, -0.04))
    fit = adjust(
        corners_of(camera, projector, depth_m=0.5, seed=0),
        SIZE,
        SIZE,
        radial_terms=3,
        tangential=True,
    )
    assert fit.undetermined == {}
    for device in (fit.camera, fit.projector):
        for k, name in ((0, "k1"), (1, "k2"), (4, "k3")):
            off = abs(device.distortion[k] - camera.distortion[k])
            assert off < 5 * fit.deviation[f"camera.{name}"]


@pytest.mark.slow
def test_the_relative_pose_is_more_precise_if_the_fit_models_corner_errors_of_the_camera():
    """The code, a hundred times more precise than the corners, determines the relative pose.

    A fit that ignores the camera's error in the projector position loses this precision.
    """
    lenses = lens(1500.0, (-0.1, 0.0, 0.0, 0.0, 0.0)), lens(1400.0, (0.0,) * 5)
    carried = np.array([[0.9, 0.1], [-0.15, 1.1]])
    words = {"depth_m": 0.6, "seed": 5, "per_camera_px": carried, "code_px": NOISE_PX / 100}
    corners = corners_of(*lenses, **words).only(np.arange(567) % 4 == 0)
    with_error, without_error = (
        adjust(one, SIZE, SIZE, radial_terms=1, tangential=False)
        for one in (corners, replace(corners, per_camera_px=np.zeros_like(corners.per_camera_px)))
    )
    for name in ("T_proj_cam.rotation_x_rad", "T_proj_cam.rotation_z_rad"):
        assert with_error.deviation[name] < 0.2 * without_error.deviation[name]
    for fit in (with_error, without_error):
        baseline_m = np.linalg.norm(fit.T_cam_proj[:3, 3])
        assert abs(baseline_m - 0.15) < 4 * fit.deviation["baseline_m"]


@pytest.mark.slow
def test_deviations_scale_with_the_square_root_of_the_number_of_corners():
    """34 parameters reduce the squared residuals of 36 corners by a quarter, of 324 by a fortieth.

    Without a correction, deviations would be 12 % off; the error of the mean of four fits is 3 %.
    """
    camera = projector = lens(1500.0, (-0.1, 0.0, 0.0, 0.0, 0.0))
    ratio = []
    for seed in range(4):
        exact = corners_of(camera, projector, depth_m=0.6, seed=seed, noise_px=0.0, code_px=0.0)
        corner = (exact.view < 3) & np.isin(np.arange(567) % 81, np.arange(0, 81, 7))
        few, rng = exact.only(corner), np.random.default_rng(seed)
        many = joined([few] * 9)
        stated = [
            adjust(noisy(one, rng), SIZE, SIZE, radial_terms=1, tangential=False).deviation
            for one in (few, many)
        ]
        ratio += [stated[0][name] / stated[1][name] / 3 for name in ("baseline_m", "camera.fx_px")]
    assert np.mean(ratio) == pytest.approx(1, abs=0.06)


@pytest.mark.slow
def test_a_lens_without_distortion_is_calibrated_without_distortion():
    camera = projector = lens(1500.0, (0.0,) * 5)
    fit = adjust(
        corners_of(camera, projector, depth_m=0.6, seed=4),
        SIZE,
        SIZE,
        radial_terms=3,
        tangential=False,
    )
    assert len(fit.undetermined) == 6
    assert not fit.camera.has_distortion
    assert not fit.projector.has_distortion
