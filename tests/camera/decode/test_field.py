"""Pixels outside the projector's picture have their own reason, by geometry alone."""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from stage import askew_rig, centre_rays, centred, make_rig, optics

from graycast.base.frames import transform_points
from graycast.camera.decode import CodeMap, Reason, triangulate
from graycast.camera.decode.field import beside_projector
from graycast.rig.optics import in_picture, project

LENS = (-0.15, 0.08, 0.01, -0.008, 0.02)


def ranged(rig):
    return replace(rig, near_m=0.6, far_m=1.0)


def test_pixels_outside_the_projector_of_a_parallel_rig_follow_a_closed_form():
    """Oracle: similar triangles. At the depth z a camera pixel is at x = (u - c) z / f, and the
    projector lights half of its width times z / f' on either side of its axis. No depth of the
    range is lit exactly if both ends of the ray are beyond the same side.
    """
    rig = ranged(
        make_rig(centred(64, 48, 70.0), centred(40, 30, 80.0), baseline_m=(0.06, 0.02, 0.0))
    )
    never = np.ones((48, 64), dtype=bool)
    for z in np.linspace(0.6, 1.0, 4001):
        x_m, y_m = (np.arange(64) - 31.5) * z / 70 - 0.06, (np.arange(48) - 23.5) * z / 70 - 0.02
        never &= ~((np.abs(x_m) <= 20 * z / 80)[None] & (np.abs(y_m) <= 15 * z / 80)[:, None])
    beside = beside_projector(rig)
    assert 0.3 < never.mean() < 0.9
    assert not (beside & ~never).any()
    assert (never & ~beside).mean() < 0.02  # Some rays pass through a corner.


@pytest.mark.slow
@pytest.mark.parametrize("lens", [slow((0.0,) * 5), LENS])
def test_a_pixel_that_the_projector_can_light_is_never_outside_its_picture(lens):
    """Oracle: 200 points on each ray, projected one by one."""
    rig = ranged(askew_rig(camera=optics(150, 110, 90), projector=optics(31, 26, 44)))
    rig = replace(rig, projector=replace(rig.projector, distortion=lens))
    lit = np.zeros((110, 150), dtype=bool)
    for z in np.linspace(0.6, 1.0, 200):
        point = transform_points(rig.T_proj_cam, z * centre_rays(rig.camera))
        lit |= in_picture(rig.projector, project(rig.projector, point))
    beside = beside_projector(rig)
    assert not (beside & lit).any()
    assert (beside | lit).mean() > 0.95


def test_dark_pixels_outside_the_projector_are_no_shadow_and_lit_pixels_keep_codes():
    rig = ranged(make_rig(centred(64, 48, 70.0), centred(40, 30, 80.0)))
    beside = beside_projector(rig)
    reason = np.full((48, 64), Reason.SHADOW, dtype=np.uint8)
    reason[:, ::2] = Reason.LOW_MODULATION
    reason[:8] = Reason.DECODED
    code = np.full((48, 64), np.nan, dtype=np.float32)
    column = code.copy()
    column[:8] = 20.0
    codes = CodeMap(
        column=column,
        row=code,
        sigma_column=np.full_like(code, 0.1),
        sigma_row=code.copy(),
        modulation=code.copy(),
        reason=reason,
    )
    reasons = triangulate(codes, rig).reason
    assert (reasons[8:][beside[8:]] == Reason.OUTSIDE_PROJECTOR).all()
    np.testing.assert_array_equal(reasons[8:][~beside[8:]], reason[8:][~beside[8:]])
    assert set(np.unique(reasons[:8])) <= {Reason.DECODED, Reason.OUT_OF_RANGE}
