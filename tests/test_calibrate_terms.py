"""Radial terms that the corners do not determine are 0 and said so; those that they do are kept."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.calibrate.adjust import Observations, adjust
from graycast.frames import inverse, rigid, transform_points
from graycast.optics import Optics, project

NOISE_PX = 0.08
SIZE = (1280, 1024)


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


def seen_by(camera, projector, *, depth_m, seed):
    """Corners of nine tilted boards in both devices, off by noise; the code has a tenth of it."""
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
    return Observations(
        view=view,
        point_m=point_m,
        camera_px=camera_px + rng.normal(0, NOISE_PX, camera_px.shape),
        projector_px=projector_px + rng.normal(0, NOISE_PX, camera_px.shape),
        per_camera_px=np.zeros((len(view), 2, 2)),
    )


@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_terms_that_a_long_lens_does_not_show_are_left_out_and_told(seed):
    """The field is 20 degrees wide, where r^6 is under 1e-4: k3 is anything, k1 is not."""
    camera = projector = lens(3600.0, (-0.3, 0.0, 0.0, 0.0, 0.0))
    seen = seen_by(camera, projector, depth_m=0.8, seed=seed)
    fit = adjust(seen, SIZE, SIZE, radial_terms=3, tangential=True)
    for name, found in (("camera", fit.camera), ("projector", fit.projector)):
        value, sigma = fit.undetermined[f"{name}.k3"]
        assert abs(value) < 5 * sigma
        assert sigma > 1  # a number like -113 +- 34: of no lens
        assert found.distortion[4] == 0
        assert f"{name}.k3" not in fit.deviation
        assert abs(found.distortion[0] + 0.3) < 5 * fit.deviation[f"{name}.k1"]
    away = project(fit.camera, np.array([[0.15, 0.12, 0.9], [-0.15, -0.12, 0.9]]))
    true = project(camera, np.array([[0.15, 0.12, 0.9], [-0.15, -0.12, 0.9]]))
    assert np.abs(away - true).max() < 2.0  # at the picture's corners


def test_terms_that_a_wide_lens_shows_are_kept():
    camera = projector = lens(750.0, (-0.21, 0.13, -0.0009, 0.0012, -0.04))
    fit = adjust(
        seen_by(camera, projector, depth_m=0.5, seed=0), SIZE, SIZE, radial_terms=3, tangential=True
    )
    assert fit.undetermined == {}
    for found in (fit.camera, fit.projector):
        for k, name in ((0, "k1"), (1, "k2"), (4, "k3")):
            off = abs(found.distortion[k] - camera.distortion[k])
            assert off < 5 * fit.deviation[f"camera.{name}"]


@pytest.mark.slow
def test_a_lens_without_distortion_comes_out_as_one():
    camera = projector = lens(1500.0, (0.0,) * 5)
    fit = adjust(
        seen_by(camera, projector, depth_m=0.6, seed=4),
        SIZE,
        SIZE,
        radial_terms=3,
        tangential=False,
    )
    assert len(fit.undetermined) == 6
    assert not fit.camera.has_distortion
    assert not fit.projector.has_distortion
