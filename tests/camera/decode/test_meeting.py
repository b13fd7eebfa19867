"""The fast intersection of rays and planes agrees with the plain one."""

from dataclasses import replace

import numpy as np
import pytest
from lenses import BEAM, LENS
from plain_meeting import beside_plain, meet_plain, off_the_line_plain
from stage import askew_rig, optics

from graycast.camera.decode.field import beside_projector
from graycast.camera.decode.meeting import lens_of, meet, off_the_line_px, rows_of
from graycast.rig.optics import mask_points, mask_rays, picture_rays, points, rays


def positions(rig, coded, seed):
    """Return rays and positions of a thousand pixels; a third has no position along the planes."""
    rng = np.random.default_rng(seed)
    count, projector = 1000, rig.projector
    camera_px = rng.uniform(0, [rig.camera.width_px - 1, rig.camera.height_px - 1], (count, 2))
    place = rng.uniform(0, [projector.width_px - 1, projector.height_px - 1], (count, 2))
    across, along = place[:, coded].copy(), place[:, 1 - coded].copy()
    along[::3] = np.nan
    across[5] = np.nan
    return rays(rig.camera, camera_px), across, along


@pytest.mark.parametrize("coded", [0, 1])
@pytest.mark.parametrize("distortion", [(0.0,) * 5, BEAM])
def test_the_compiled_intersection_of_rays_agrees_with_numpy(coded, distortion):
    """The tolerance is 1e-9, because OpenCV removes distortion by iteration."""
    rig = askew_rig(projector=optics(64, 48, 52, distortion=distortion))
    ray, across, along = positions(rig, coded, seed=coded)
    depth_m, slope_m, off_px = np.empty((3, len(ray)))
    T, lens = rows_of(rig.T_proj_cam, coded), lens_of(rig.projector, coded)
    assert meet(ray, across, along, T, lens, depth_m, slope_m)
    plain_m, plain_slope_m = meet_plain(ray, across, along, rig, coded)
    assert np.isfinite(plain_m).sum() > 700
    np.testing.assert_allclose(depth_m, plain_m, rtol=1e-8)
    np.testing.assert_allclose(slope_m, plain_slope_m, rtol=1e-8)
    off_the_line_px(ray, plain_m, along, T, lens, off_px)
    plain_px = off_the_line_plain(ray, plain_m, along, rig, coded)
    assert np.isfinite(plain_px).sum() > 100
    np.testing.assert_allclose(off_px, plain_px, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("coded", [0, 1])
def test_a_lens_distortion_without_an_inverse_is_reported(coded):
    """With k1 = -2 a lens folds over at a radius of sqrt(1/6), inside of the picture."""
    rig = askew_rig(projector=optics(64, 48, 40, distortion=(-2.0, 0.0, 0.0, 0.0, 0.0)))
    ray, across, along = positions(rig, coded, seed=coded)
    depth_m, slope_m = np.empty((2, len(ray)))
    T, lens = rows_of(rig.T_proj_cam, coded), lens_of(rig.projector, coded)
    assert not meet(ray, across, along, T, lens, depth_m, slope_m)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, BEAM])
def test_the_compiled_field_of_the_projector_agrees_with_numpy(distortion):
    """The projector's picture ends inside the camera's on two or more sides."""
    rig = askew_rig(
        camera=optics(150, 110, 90, distortion=LENS),
        projector=optics(31, 26, 44, distortion=distortion),
    )
    rig = replace(rig, near_m=0.6, far_m=1.0)
    plain = beside_plain(rig)
    assert 0.2 < plain.mean() < 0.9
    assert np.array_equal(beside_projector(rig), plain)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, LENS])
def test_rays_and_points_inside_a_mask_equal_the_same_pixels_of_the_picture(distortion):
    """The pixels of a mask are in row order; a single pixel has the ray of its position."""
    camera = optics(20, 14, 30, distortion=distortion)
    rng = np.random.default_rng(2)
    mask, depth_m = rng.random((14, 20)) < 0.4, rng.uniform(0.5, 2.0, (14, 20))
    assert np.array_equal(mask_rays(camera, mask), picture_rays(camera)[mask])
    assert np.array_equal(mask_points(camera, depth_m, mask), points(camera, depth_m)[mask])
    single = rays(camera, np.array([[7.0, 3.0]]))[0]
    np.testing.assert_allclose(picture_rays(camera)[3, 7], single, rtol=1e-12)
