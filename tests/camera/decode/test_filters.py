"""Filters of depth maps: surfaces stay at any tilt, and points between them are removed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage, signal

from graycast.base.frames import pixel_grid
from graycast.camera.decode.filters import filter_depth
from graycast.camera.decode.maps import DepthMap, FilterSpec
from graycast.camera.decode.reasons import Reason
from graycast.rig.optics import Optics, rays
from graycast.rig.pair import preset_rig

# In a narrow field (0.36 mm a pixel at 0.8 m), a plane's angle of incidence is nearly its tilt.
CAMERA = Optics(width_px=240, height_px=200, fx_px=2250.0, fy_px=2250.0, cx_px=119.5, cy_px=99.5)
RIG = replace(preset_rig("paper"), camera=CAMERA)
SHAPE = (200, 240)
SIGMA_M = 1e-4
ALL = FilterSpec(flying_angle_deg=75.0, outlier_sigmas=4.0, island_px=30, smoothing_px=0.55)
FLYING = FilterSpec(flying_angle_deg=75.0)
OUTLIER = FilterSpec(outlier_sigmas=4.0)


def plane(tilt_deg=0.0, azimuth_deg=0.0, *, z_m=0.8):
    """Return the depth of a plane through the optical axis at `z_m`: z = z_m n_z / (n . ray)."""
    tilt, azimuth = math.radians(tilt_deg), math.radians(azimuth_deg)
    n = np.array([math.cos(azimuth), math.sin(azimuth), 0]) * math.sin(tilt)
    n[2] = math.cos(tilt)
    return z_m * n[2] / (rays(CAMERA, pixel_grid(*SHAPE)) @ n)


def depth_map(z_m, *, sigma_m=SIGMA_M, seed=None):
    """Return a depth map, with white noise of that deviation if a seed is given; NaN is shadow."""
    if seed is not None:
        z_m = z_m + sigma_m * np.random.default_rng(seed).standard_normal(SHAPE)
    known = np.isfinite(z_m)
    reason = np.where(known, Reason.DECODED, Reason.SHADOW).astype(np.uint8)
    sigma = np.where(known, sigma_m, np.nan).astype(np.float32)
    return DepthMap(depth_m=z_m.astype(np.float32), sigma_m=sigma, reason=reason, camera=CAMERA)


def removed(z_m, spec, **noise):
    return filter_depth(depth_map(z_m, **noise), spec, RIG).reason == Reason.OUTLIER


# --- all filters --------------------------------------------------------------------------------


@pytest.mark.parametrize("azimuth_deg", [0, 37, 90])
@pytest.mark.parametrize("tilt_deg", [0, 45, 70])
def test_filters_remove_no_pixel_of_a_tilted_plane(tilt_deg, azimuth_deg):
    """At four sigmas, the outlier filter removes 6 of 100,000 normal errors; here, it removes 3."""
    z_m = plane(tilt_deg, azimuth_deg)
    assert not removed(z_m, ALL).any()
    assert removed(z_m, ALL, seed=1).sum() < 12
    assert not removed(z_m, FLYING, seed=1).any()


def test_filters_that_are_off_change_no_depth_and_no_filter_fills_a_hole():
    z_m = plane(30)
    z_m[50:60, 70:90] = np.nan
    noisy = depth_map(z_m, seed=1)
    for off in (FilterSpec(), FilterSpec(flying_angle_deg=0.0, outlier_sigmas=0.0, island_px=0)):
        same = filter_depth(noisy, off, RIG)
        assert np.array_equal(same.depth_m, noisy.depth_m, equal_nan=True)
        assert np.array_equal(same.sigma_m, noisy.sigma_m, equal_nan=True)
    filtered = filter_depth(noisy, ALL, RIG)
    gone = filtered.reason != Reason.DECODED
    assert (filtered.reason[50:60, 70:90] == Reason.SHADOW).all()
    assert np.array_equal(gone, np.isnan(filtered.depth_m))
    assert np.array_equal(gone, np.isnan(filtered.sigma_m))


def test_a_depth_map_of_another_size_or_without_sigma_is_refused():
    narrow = Optics(width_px=200, height_px=200, fx_px=1.0, fy_px=1.0, cx_px=0.0, cy_px=0.0)
    with pytest.raises(ValueError, match="240 x 200 px, the rig's camera 200 x 200"):
        filter_depth(depth_map(plane()), ALL, replace(RIG, camera=narrow))
    with pytest.raises(ValueError, match="every depth its sigma_m"):
        filter_depth(depth_map(plane(), sigma_m=np.nan), ALL, RIG)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("flying_angle_deg", 90.0),
        ("outlier_sigmas", -1.0),
        ("outlier_share", math.nan),
        ("island_px", -3),
        ("smoothing_px", 11.0),
        ("hidden_sigmas", -1.0),
        ("step_angle_deg", 90.0),
    ],
)
def test_impossible_filter_settings_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        FilterSpec(**{name: value})


# --- flying pixels -----------------------------------------------------------------------------


def disc_on_ground(rim_px, *, random):
    """A disc of 60 px is 50 mm in front of the ground; its rim of `rim_px` is between the two.

    The depth of the rim falls outwards, as after blur, with small deviations; or it is random.
    """
    y, x = np.indices(SHAPE)
    radius = np.hypot(y - 99.5, x - 119.5)
    rim = (radius >= 60) & (radius < 60 + rim_px)
    share = np.random.default_rng(1).uniform(0.1, 0.9, SHAPE)
    if not random:
        share = 0.1 + 0.7 * (radius - 60) / max(rim_px, 1.0) + 0.1 * share
    between = np.where(rim, share, (radius >= 60).astype(float))
    return plane(20) - 0.05 * (1 - between), rim


@pytest.mark.parametrize("rim_px", [0.7, 1.5])
def test_flying_pixels_of_a_step_are_removed_and_its_surfaces_are_kept(rim_px):
    """Both surfaces are at least 5 mm away from the pixel: 14 pixels, or 86 degrees."""
    z_m, rim = disc_on_ground(rim_px, random=False)
    gone = removed(z_m, FLYING, seed=2)
    assert gone[rim].mean() > 0.93
    assert not gone[~rim].any()
    clean, _ = disc_on_ground(0.0, random=False)
    assert not removed(clean, FLYING, seed=2).any()


def test_all_filters_together_leave_under_3_percent_of_the_flying_pixels_of_a_step():
    z_m, rim = disc_on_ground(1.5, random=True)
    at_step = ndimage.binary_dilation(rim, iterations=1)
    filtered = filter_depth(depth_map(z_m, seed=2), ALL, RIG)
    left = rim & (filtered.reason == Reason.DECODED)
    assert left.sum() < 0.03 * (at_step & (filtered.reason == Reason.DECODED)).sum()


def test_a_pixel_between_an_edge_and_its_shadow_is_a_flying_pixel():
    """It is behind the edge without a neighbour beyond; after a hole of two pixels is ground."""
    edge = np.full(SHAPE, 0.8)
    edge[:, 101:140], edge[:, 140:] = np.nan, 0.86
    hanging = edge.copy()
    hanging[:, 100] = 0.82
    for z_m, turned in ((hanging, hanging[:, ::-1]), (hanging[::-1], hanging[:, ::-1])):
        assert removed(z_m, FLYING)[:, 100].all() and removed(z_m, FLYING).sum() == 200
        assert removed(turned, FLYING)[:, 139].all() and removed(turned, FLYING).sum() == 200
    assert not removed(edge, FLYING).any()
    ground = np.full(SHAPE, 0.8)
    ground[:, 100:], ground[:, 101:103] = 0.85, np.nan
    assert not removed(ground, FLYING).any()


def test_a_thin_wire_and_a_smooth_steep_slope_are_not_flying_pixels():
    wire = plane()
    wire[:, 100] -= 0.02
    assert not removed(wire, FLYING).any()
    assert not removed(plane(80), FLYING).any()
    assert not removed(plane(80), FLYING, seed=3).any()


def test_a_steep_flank_of_several_pixels_is_not_removed_as_flying_pixels():
    """It is between two levels at 84 degrees; from four pixels on, its ends are out of reach."""
    for width_px, stays in ((2, False), (8, True)):
        fall = np.clip(np.arange(240) - 100, 0, width_px) * 3.5e-3
        assert removed(plane() + fall, FLYING).any() != stays


def test_steps_of_plain_gray_code_depth_are_not_flying_pixels():
    """Plain Gray code's staircase: 2 mm treads on a slope, sigma 2 mm / sqrt(12)."""
    stairs = np.round(plane(40) / 2e-3) * 2e-3
    assert not removed(stairs, FLYING, sigma_m=2e-3 / math.sqrt(12)).any()


def test_a_slope_within_three_sigmas_of_noise_is_not_a_flying_pixel():
    """A pixel is in the middle of a step; each slope is the limit plus some deviations of noise.

    The limit is tan(75) times a pixel's width at that depth; two pixels differ by sqrt(2) sigma.
    """
    width_m = 0.8 / CAMERA.fx_px
    for sigmas, goes in ((2.8, False), (3.2, True)):
        flank_m = math.tan(math.radians(75)) * width_m + sigmas * math.sqrt(2) * SIGMA_M
        step = plane()
        step[:, 120] += flank_m
        step[:, 121:] += 2 * flank_m
        gone = removed(step, FLYING)
        assert gone.any() == goes
        assert not gone[:, :120].any() and not gone[:, 121:].any()


# --- outliers ----------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt_deg", [0, 60])
@pytest.mark.parametrize("spike_sigmas", [-12.0, 9.0, 200.0])
def test_single_outliers_are_removed_and_their_neighbours_are_kept(tilt_deg, spike_sigmas):
    z_m = plane(tilt_deg, 30)
    spikes = np.zeros(SHAPE, dtype=bool)
    spikes[5::13, 7::17] = True
    gone = removed(z_m + spikes * spike_sigmas * SIGMA_M, OUTLIER, seed=4)
    assert gone[spikes].mean() > 0.97
    assert gone[~spikes].mean() < 3e-4


def test_a_group_of_four_pixels_at_one_depth_is_not_an_outlier():
    """Each of 2 x 2 pixels has three others at its depth; each of three in a corner has two."""
    z_m = plane(30)
    z_m[40:42, 60:62] -= 0.02
    assert not removed(z_m, OUTLIER).any()
    z_m[41, 61] += 0.02
    assert np.argwhere(removed(z_m, OUTLIER)).tolist() == [[40, 60], [40, 61], [41, 60]]


def test_deviations_below_the_limit_relative_to_depth_are_kept():
    z_m = plane()
    z_m[50, 50] += 2e-4
    z_m[90, 90] += 4e-4
    gone = removed(z_m, OUTLIER, sigma_m=1e-6)  # 3e-4 of 0.8 m is 0.24 mm
    assert not gone[50, 50] and gone[90, 90] and gone.sum() == 1


def test_steps_corners_and_wires_are_not_outliers():
    """Only the last pixel of a wire is one, since it has two neighbours at its depth."""
    detail = plane(30)
    detail[40:80, 40:80] -= 0.03  # a block with corners
    detail[100:180, 100] -= 0.02  # a wire
    detail[np.arange(100, 150), np.arange(150, 200)] -= 0.02  # a diagonal wire
    detail[20:23, 200:203] -= 0.01
    ends = [[100, 100], [100, 150], [149, 199], [179, 100]]
    assert np.argwhere(removed(detail, OUTLIER)).tolist() == ends
    assert removed(detail, OUTLIER, seed=5).sum() < 15


@pytest.mark.parametrize("tilt_deg", [0, 60])
def test_repaired_outliers_get_the_depth_of_the_surface_without_extra_noise(tilt_deg):
    """Each of 200 outliers becomes a hole without repair. The median of 24 normal numbers has a
    deviation of 1.25 / sqrt(24) of theirs; the estimated slopes add a little.
    """
    clean = plane(tilt_deg, 37)
    spike = np.zeros(SHAPE, dtype=bool)
    spike[5:-5:13, 5:-5:17] = True
    z_m = clean + np.where(spike, 3e-3, 0)
    spec = FilterSpec(outlier_sigmas=4.0, outlier_repair=True)
    noisy = depth_map(z_m, seed=3)
    filtered = filter_depth(noisy, spec, RIG)
    assert np.isfinite(filtered.depth_m).all()
    assert (filtered.reason == Reason.DECODED).all()
    assert np.isnan(filter_depth(noisy, OUTLIER, RIG).depth_m[spike]).all()
    error_m = (filtered.depth_m - clean)[spike]
    assert np.abs(error_m).max() < 4 * SIGMA_M
    assert error_m.std() < 0.5 * SIGMA_M
    untouched = ~spike & (np.abs(noisy.depth_m - clean) < 3 * SIGMA_M)
    assert np.array_equal(filtered.depth_m[untouched], noisy.depth_m[untouched])


def test_repair_removes_an_outlier_that_no_whole_surface_surrounds():
    """At a step, it could have one of two depths."""
    z_m = plane()
    z_m[:, 120:] += 0.05
    z_m[100, 119] += 0.02
    spec = FilterSpec(outlier_sigmas=4.0, outlier_repair=True)
    assert removed(z_m, spec)[100, 119] == removed(z_m, OUTLIER)[100, 119]
    lone = np.full(SHAPE, np.nan)
    lone[98:103, 118:123] = plane()[98:103, 118:123]
    lone[98:100] = np.nan
    lone[100, 120] += 0.02
    assert removed(lone, OUTLIER)[100, 120] and removed(lone, spec)[100, 120]


# --- edges -------------------------------------------------------------------------------------


@pytest.mark.parametrize("edge_px", [1.0, 1.5, 3.0])
def test_pixels_near_depth_edges_are_removed_but_not_at_the_picture_s_border(edge_px):
    """Oracle: a distance transform of each surface; a wavy step of 3 cm, and a hole."""
    row, column = np.indices(SHAPE)
    near = column < 120 + 10 * np.sin(row / 9)
    hole = np.hypot(row - 60, column - 60) < 5
    z_m = np.where(hole, np.nan, np.where(near, 0.8, 0.83))
    valid = np.isfinite(filter_depth(depth_map(z_m), FilterSpec(edge_px=edge_px), RIG).depth_m)
    for surface in (near & ~hole, ~near):
        inner = ndimage.distance_transform_edt(surface) > edge_px
        assert np.array_equal(valid[surface], inner[surface])


# --- islands -----------------------------------------------------------------------------------


def small_parts(mask, below_px):
    label, count = ndimage.label(mask)
    size = np.bincount(label.ravel(), minlength=count + 1)
    return mask & (size[label] < below_px)


@pytest.mark.parametrize("island_px", [2, 30, 200])
def test_only_pixels_of_islands_smaller_than_the_limit_are_removed(island_px):
    """Oracle: SciPy's labels for each of two levels of a percolating random pattern."""
    rng = np.random.default_rng(6)
    known, high = rng.random(SHAPE) < 0.9, rng.random(SHAPE) < 0.7
    z_m = np.where(known, np.where(high, plane(10), plane(10) + 0.05), np.nan)
    expected = small_parts(known & high, island_px) | small_parts(known & ~high, island_px)
    assert 50 < expected.sum() < 0.9 * known.sum()
    gone = removed(z_m, FilterSpec(island_px=island_px))
    assert np.array_equal(gone, expected)


# --- smoothing ---------------------------------------------------------------------------------


def gauss(smoothing_px):
    """Return the kernel as documented: a Gaussian down to 1 % of its maximum."""
    y, x = np.indices((41, 41)) - 20
    kernel = np.exp(-(x**2 + y**2) / (2 * smoothing_px**2))
    kernel[kernel < 0.01] = 0
    return kernel / kernel.sum()


@pytest.mark.parametrize("smoothing_px", [0.4, 0.55, 1.0])
@pytest.mark.parametrize("tilt_deg", [0, 60])
def test_the_kernel_sets_variance_and_correlation_of_smoothed_white_noise(tilt_deg, smoothing_px):
    """Closed form: variance sum k^2, the kernel's correlation. Tolerance: 4 standard errors."""
    z_m = plane(tilt_deg, 20)
    kernel = gauss(smoothing_px)
    law = signal.correlate2d(kernel, kernel, mode="full")
    share, lag_1 = law[40, 40], law[40, 41] / law[40, 40]
    smooth = filter_depth(depth_map(z_m, seed=7), FilterSpec(smoothing_px=smoothing_px), RIG)
    inside = (slice(6, -6), slice(6, -6))
    error = (smooth.depth_m - z_m)[inside]
    independent = error.size * (kernel**2).sum()  # independent errors, by the kernel's area
    assert abs(error.mean()) < 4 * SIGMA_M / math.sqrt(error.size)
    assert abs(error.var() / SIGMA_M**2 / share - 1) < 4 * math.sqrt(2 / independent)
    pairs = error[:, 1:] * error[:, :-1]
    assert abs(pairs.mean() / error.var() - lag_1) < 4 / math.sqrt(independent)
    stated = smooth.sigma_m[inside] / (SIGMA_M * math.sqrt(share))
    assert abs(np.median(stated) - 1) < 0.01 and np.quantile(np.abs(stated - 1), 0.99) < 0.02
    if smoothing_px == 0.55:
        assert 0.2 < lag_1 < 0.5


def test_sigma_of_smoothed_depth_agrees_with_its_error_even_at_holes_and_borders():
    """With uneven sigma and many holes, error over stated sigma is standard normal."""
    rng = np.random.default_rng(8)
    z_m, sigma_m = plane(50, 70), SIGMA_M * rng.uniform(0.5, 2.0, SHAPE)
    z_m = np.where(rng.random(SHAPE) < 0.3, np.nan, z_m)
    smooth = filter_depth(
        depth_map(z_m, sigma_m=sigma_m, seed=9), FilterSpec(smoothing_px=0.8), RIG
    )
    score = ((smooth.depth_m - z_m) / smooth.sigma_m)[np.isfinite(z_m)]
    assert abs(score.mean()) < 0.03 and abs(score.var() - 1) < 0.05


@pytest.mark.parametrize("tilt_deg", [0, 60])
def test_smoothing_does_not_bend_a_plane_at_its_borders(tilt_deg):
    """A one-sided mean would move the border by much of a pixel's slope, 0.3 mm."""
    z_m = plane(tilt_deg)
    z_m[:, 100:120] = np.nan
    smooth = filter_depth(depth_map(z_m), FilterSpec(smoothing_px=1.5), RIG)
    assert np.nanmax(np.abs(smooth.depth_m - z_m)) < 2e-7
    assert np.array_equal(np.isnan(smooth.depth_m), np.isnan(z_m))


@pytest.mark.parametrize("step_m", [2e-3, 20e-3])
def test_smoothing_keeps_position_and_height_of_a_step(step_m):
    """A difference of twenty sigmas is a step at any slope in degrees."""
    z_m = plane()
    z_m[:, 120:] += step_m
    smooth = filter_depth(depth_map(z_m, seed=10), FilterSpec(smoothing_px=1.0), RIG)
    for column in (118, 119, 120, 121):
        error = smooth.depth_m[:, column] - z_m[:, column]
        assert abs(error.mean()) < 4 * SIGMA_M / math.sqrt(200 / 4)
        assert np.abs(error).max() < 5 * SIGMA_M
