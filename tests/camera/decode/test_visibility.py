"""Order along epipolar lines: there is no step on the side away from the projector."""

import numpy as np
import pytest
from stage import centred, make_rig

from graycast.base.frames import axis_rotation
from graycast.camera.decode import DepthMap, Reason
from graycast.camera.decode.visibility import without_hidden

F_PX, BASELINE_M, WALL_M, BLOCK_M = 300.0, 0.2, 0.9, 0.8
LEFT, RIGHT = 60, 100  # columns of the block
GAP_PX = F_PX * BASELINE_M * (1 / BLOCK_M - 1 / WALL_M)  # its shadow's width: f b (1 / z1 - 1 / z2)


def rig_of(side):
    """Return a rig; the projector's `side` is 1 (right of the camera), -1 (left) or 'down'."""
    offset = (0.0, BASELINE_M, 0.0) if side == "down" else (side * BASELINE_M, 0.0, 0.0)
    return make_rig(centred(160, 160, F_PX), centred(640, 640, 600.0), baseline_m=offset)


def block(side, *, shadow=True):
    """Return an ideal scanner's picture of a block in front of a wall, with its shadow."""
    z_m = np.full((160, 160), WALL_M, dtype=np.float32)
    z_m[:, LEFT:RIGHT] = BLOCK_M
    gap = int(np.ceil(GAP_PX))
    lost = np.s_[:, RIGHT : RIGHT + gap] if side == -1 else np.s_[:, LEFT - gap : LEFT]
    if shadow:
        z_m[lost] = np.nan
    return (z_m.T if side == "down" else z_m).copy()


def hidden(z_m, side, sigmas=3.0, sigma_m=1e-4):
    known = np.isfinite(z_m)
    depth = DepthMap(
        depth_m=z_m,
        sigma_m=np.where(known, np.float32(sigma_m), np.float32(np.nan)),
        reason=np.where(known, Reason.DECODED, Reason.SHADOW).astype(np.uint8),
        camera=rig_of(side).camera,
    )
    filtered = without_hidden(depth, rig_of(side), sigmas=sigmas)
    gone = filtered.reason == Reason.OUTLIER
    assert np.array_equal(np.isnan(filtered.depth_m), gone | ~known)
    assert np.array_equal(np.isnan(filtered.sigma_m), gone | ~known)
    return gone


@pytest.mark.parametrize("side", [1, -1, "down"])
def test_exactly_the_pixels_in_the_shadow_of_a_block_are_removed(side):
    """Oracle: the shadow's width from similar triangles."""
    gone = hidden(block(side, shadow=False), side)
    rows = gone.T if side == "down" else gone
    assert (rows == rows[0]).all()
    where = np.flatnonzero(rows[0])
    assert abs(len(where) - GAP_PX) < 1
    beside = range(RIGHT, RIGHT + len(where)) if side == -1 else range(LEFT - len(where), LEFT)
    assert where.tolist() == list(beside)


@pytest.mark.parametrize("side", [1, -1, "down"])
def test_the_visibility_filter_removes_no_pixel_of_an_ideal_scanner(side):
    assert not hidden(block(side), side).any()


def test_the_steepest_visible_slope_is_kept_even_with_noise():
    """The positions of a wall increase by a tenth of a facing wall's from pixel to pixel."""
    x = (np.arange(160) - 79.5) / F_PX
    inverse = 1 / WALL_M + 0.9 * x / BASELINE_M
    z_m = np.broadcast_to(1 / inverse, (160, 160))
    assert not hidden(z_m.astype(np.float32), 1).any()
    noisy = z_m + 3e-4 * np.random.default_rng(1).standard_normal(z_m.shape)
    assert not hidden(noisy.astype(np.float32), 1, sigmas=5.0, sigma_m=3e-4).any()


def test_a_block_seen_with_a_toed_in_projector_has_no_outliers():
    toed = make_rig(
        centred(160, 160, F_PX),
        centred(1200, 640, 600.0),
        baseline_m=(BASELINE_M, 0, 0),
        rotation=axis_rotation("y", -0.22),
    )
    z_m = block(1)
    depth = DepthMap(
        depth_m=z_m,
        sigma_m=np.where(np.isfinite(z_m), np.float32(1e-4), np.float32(np.nan)),
        reason=np.where(np.isfinite(z_m), 0, 1).astype(np.uint8),
        camera=toed.camera,
    )
    assert not (without_hidden(depth, toed, sigmas=3.0).reason == Reason.OUTLIER).any()
