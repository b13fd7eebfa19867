"""Short gaps along the projector's lines: filled on a surface, never across a step or a shadow."""

import math
from dataclasses import replace

import numpy as np
import pytest

from graycast.decode import DepthMap, FilterSpec, Reason, filter_depth
from graycast.decode.gaps import with_gaps_filled
from graycast.frames import pixel_grid
from graycast.optics import Optics, rays
from graycast.rig import preset_rig

CAMERA = Optics(width_px=120, height_px=100, fx_px=500.0, fy_px=500.0, cx_px=59.5, cy_px=49.5)
SHAPE = (100, 120)
RIG = replace(preset_rig("paper"), camera=CAMERA)  # its baseline lies along the rows
SIGMA_M = 2e-4


def turned(rig):
    """The same rig with a projector below the camera instead of beside it."""
    T = rig.T_cam_proj.copy()
    T[:3, 3] = T[[1, 0, 2], 3]
    return replace(rig, T_cam_proj=T)


def tilted(tilt_deg, azimuth_deg):
    n = np.array([math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg)), 0.0])
    n = n * math.sin(math.radians(tilt_deg)) + [0, 0, math.cos(math.radians(tilt_deg))]
    return 0.8 * n[2] / (rays(CAMERA, pixel_grid(*SHAPE)) @ n)


def depth_map(z_m):
    known = np.isfinite(z_m)
    return DepthMap(
        depth_m=z_m.astype(np.float32),
        sigma_m=np.where(known, SIGMA_M, np.nan).astype(np.float32),
        reason=np.where(known, Reason.DECODED, Reason.LOW_MODULATION).astype(np.uint8),
    )


@pytest.mark.parametrize(("tilt_deg", "azimuth_deg"), [(0, 0), (50, 0), (50, 90), (40, 30)])
@pytest.mark.parametrize("rig", [RIG, turned(RIG)], ids=["beside", "below"])
def test_a_gap_in_a_plane_gets_the_planes_depth(tilt_deg, azimuth_deg, rig):
    """Oracle: the plane itself. The gap runs along the lines, whichever way they run."""
    truth_m = tilted(tilt_deg, azimuth_deg)
    z_m = truth_m.copy()
    along = z_m if rig is RIG else z_m.T
    along[40:43, 20] = along[60:64, 30] = np.nan
    filled = with_gaps_filled(depth_map(z_m), rig, most_px=3)
    inside = filled.depth_m if rig is RIG else filled.depth_m.T
    expected = truth_m if rig is RIG else truth_m.T
    assert inside[40:43, 20] == pytest.approx(expected[40:43, 20], rel=1e-6)
    assert np.isnan(inside[60:64, 30]).all()  # four pixels are too many
    changed = np.isnan(z_m) & np.isfinite(filled.depth_m)
    assert changed.sum() == 3 and (filled.reason[changed] == Reason.DECODED).all()
    kept = np.isfinite(z_m)
    assert np.array_equal(filled.depth_m[kept], z_m.astype(np.float32)[kept])


def test_sigma_is_that_of_the_line_between_both_ends():
    """By many draws: the middle of one pixel is the mean of two, and so less noisy than either."""
    rng = np.random.default_rng(0)
    z_m = np.full(SHAPE, 0.8) + SIGMA_M * rng.standard_normal(SHAPE)
    z_m[1::4] = np.nan
    filled = with_gaps_filled(depth_map(z_m), RIG, most_px=1)
    gap = np.s_[1:-4:4]
    assert filled.depth_m[gap].std() == pytest.approx(SIGMA_M / math.sqrt(2), rel=0.05)
    assert filled.sigma_m[gap] == pytest.approx(SIGMA_M / math.sqrt(2), rel=2e-3)


def test_a_gap_beside_a_step_across_the_lines_and_at_the_border_stays():
    z_m = np.full(SHAPE, 0.8)
    z_m[50:] = 0.78
    z_m[48:50] = np.nan  # ends 20 mm apart over three pixels of 1.6 mm
    z_m[20, 40:45] = np.nan  # each is filled from above and below
    z_m[:2, 70] = z_m[-2:, 71] = np.nan
    filled = with_gaps_filled(depth_map(z_m), RIG, most_px=3).depth_m
    assert np.isnan(filled[48:50]).all() and np.isnan(filled[:2, 70]).all()
    assert np.isnan(filled[-2:, 71]).all()
    assert filled[20, 40:45] == pytest.approx(0.8)
    across = with_gaps_filled(depth_map(z_m), turned(RIG), most_px=3).depth_m
    assert np.isnan(across[20, 40:45]).all()  # along these lines it is five pixels long


def test_the_shadow_beside_a_box_stays():
    """A shadow has the box at one end and the floor at the other, in the baseline's direction."""
    z_m = np.full(SHAPE, 0.8)
    z_m[30:60, 40:60] = 0.79
    z_m[30:60, 60:63] = np.nan
    filled = with_gaps_filled(depth_map(z_m), RIG, most_px=20).depth_m
    assert np.isnan(filled[30:60, 60:63]).all()


def test_filters_fill_what_the_others_removed_and_only_where_it_is_asked():
    z_m = np.full(SHAPE, 0.8)
    z_m[50, 50] = 0.75
    spike = depth_map(z_m)
    removed = filter_depth(spike, FilterSpec(outlier_sigmas=4.0), RIG)
    assert np.isnan(removed.depth_m[50, 50])
    filled = filter_depth(spike, FilterSpec(outlier_sigmas=4.0, gap_px=1), RIG)
    assert filled.depth_m[50, 50] == pytest.approx(0.8)
    for off in (None, 0):
        same = filter_depth(
            depth_map(np.where(z_m > 0.76, z_m, np.nan)), FilterSpec(gap_px=off), RIG
        )
        assert np.isnan(same.depth_m[50, 50])
