"""A device's faults: depth of points beside pixels' centres, and pixels lost beside steps."""

import math
from dataclasses import fields
from typing import get_type_hints

import numpy as np
import pytest

from graycast.camera.decode import DepthMap, FilterSpec, Reason
from graycast.camera.faults import FaultSpec, line_amplitude, on_raster, places, with_faults
from graycast.camera.stack import decode_stack
from graycast.rig.optics import Optics

F_PX, SHAPE = 500.0, (300, 320)
CAMERA = Optics(width_px=320, height_px=300, fx_px=F_PX, fy_px=F_PX, cx_px=159.5, cy_px=149.5)


def tilted(tilt_deg, azimuth_deg):
    """z of a plane through (0, 0, 0.8), and how it rises per pixel."""
    y, x = (np.indices(SHAPE) - np.array([149.5, 159.5])[:, None, None]) / F_PX
    slope = math.tan(math.radians(tilt_deg))
    aside = x * math.cos(math.radians(azimuth_deg)) + y * math.sin(math.radians(azimuth_deg))
    return 0.8 / (1 - slope * aside)


def depth_map(z_m, sigma_m=1e-7):
    return DepthMap(
        depth_m=z_m.astype(np.float32),
        sigma_m=np.full(SHAPE, sigma_m, dtype=np.float32),
        reason=np.full(SHAPE, int(Reason.DECODED), dtype=np.uint8),
    )


@pytest.mark.parametrize(("tilt_deg", "azimuth_deg"), [(20, 0), (45, 90), (60, 30)])
def test_the_error_is_the_slope_times_a_pixels_width(tilt_deg, azimuth_deg):
    """At the axis a pixel is z / f wide, and a plane rises by tan(tilt) times that. The stated
    sigma is the errors'."""
    z_m = tilted(tilt_deg, azimuth_deg)
    placed = on_raster(depth_map(z_m), 0.25, focal_px=F_PX)
    error_m = placed.depth_m - z_m
    near = np.s_[130:170, 140:180]
    law_m = 0.25 * math.tan(math.radians(tilt_deg)) * z_m[near].mean() / F_PX
    assert error_m[near].std() == pytest.approx(law_m, rel=0.08)  # of 1600: 1.8 % one sigma
    inside = np.s_[1:-1, 1:-1]
    assert np.std((error_m / placed.sigma_m)[inside]) == pytest.approx(1, rel=0.02)


@pytest.mark.parametrize("tilt_deg", [5, 30, 70])
def test_the_error_of_a_limited_raster_ends_at_its_limit(tilt_deg):
    """Oracle: the inverse squares of both deviations add up."""
    z_m, limit_m = tilted(tilt_deg, 90), 2e-4
    placed = on_raster(depth_map(z_m), 0.25, limit_m=limit_m, focal_px=F_PX)
    near = np.s_[130:170, 140:180]
    free_m = 0.25 * math.tan(math.radians(tilt_deg)) * z_m[near].mean() / F_PX
    law_m = (free_m**-2 + limit_m**-2) ** -0.5
    assert (placed.depth_m - z_m)[near].std() == pytest.approx(law_m, rel=0.08)
    assert placed.sigma_m[near].mean() == pytest.approx(law_m, rel=0.02)


def test_the_raster_is_white_and_the_same_in_every_shot():
    z_m = tilted(45, 30)
    once, again = (on_raster(depth_map(z_m), 0.3, focal_px=F_PX) for _ in range(2))
    assert np.array_equal(once.depth_m, again.depth_m)
    share = ((once.depth_m - z_m) / once.sigma_m)[1:-1, 1:-1]
    for a, b in ((share[1:], share[:-1]), (share[:, 1:], share[:, :-1])):
        assert abs((a * b).mean()) < 4 / math.sqrt(share.size)


@pytest.mark.parametrize("window_px", [0.6, 1.0, 1.7])
def test_places_of_overlapping_windows_are_the_gradient_of_a_random_field(window_px):
    """Oracle: the second derivatives of the field's autocovariance `exp(-r^2 / 4 w^2)`."""
    right, down = places((400, 420), window_px)
    for along in (right, down.T):
        assert along.std() == pytest.approx(1, rel=0.02)
        for r in (1, 2, 3):
            alike = math.exp(-((r / window_px) ** 2) / 4)
            sideways = (along[r:] * along[:-r]).mean()
            onwards = (along[:, r:] * along[:, :-r]).mean()
            assert sideways == pytest.approx(alike, abs=0.025)
            assert onwards == pytest.approx(alike * (1 - r * r / (2 * window_px**2)), abs=0.025)
    assert abs((right * down).mean()) < 0.02  # of one pixel they are independent


@pytest.mark.parametrize(("azimuth_deg", "axis"), [(0, 0), (90, 1)])
def test_with_a_window_a_slope_has_noise_in_common_across_it(azimuth_deg, axis):
    """The same law seen in depth: neighbours across the slope share noise, those along it do not.

    Half a pixel is the window, so along the slope the correlation is -0.37, and across it 0.37.
    """
    z_m = tilted(50, azimuth_deg)
    placed = on_raster(depth_map(z_m), 0.2, window_px=0.5, focal_px=F_PX)
    share = ((placed.depth_m - z_m) / placed.sigma_m)[1:-1, 1:-1]
    assert share.std() == pytest.approx(1, rel=0.02)
    share = np.moveaxis(share, axis, 0)
    assert (share[1:] * share[:-1]).mean() == pytest.approx(math.exp(-1), abs=0.03)
    assert (share[:, 1:] * share[:, :-1]).mean() == pytest.approx(-math.exp(-1), abs=0.03)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_of_a_place_s_variance_the_window_has_its_share(share):
    """Independent variances add up, and so do covariances: the rest is white."""
    right, _ = places((400, 420), 1.0, share)
    assert right.std() == pytest.approx(1, rel=0.02)
    sideways = (right[1:] * right[:-1]).mean()
    assert sideways == pytest.approx(share * math.exp(-1 / 4), abs=0.015)


def test_errors_of_a_line_are_alike_in_size():
    """Oracle: the log-normal law, whose logarithm is a Gaussian convolved with white noise."""
    factor = line_amplitude((400, 420), 0.5)
    assert (factor**2).mean() == pytest.approx(1, rel=0.03)
    log = np.log(factor)
    log -= log.mean()
    assert log.std() == pytest.approx(0.5, rel=0.02)
    for r in (1, 2, 3):
        along = (log[r:] * log[:-r]).mean() / 0.25
        assert along == pytest.approx(math.exp(-r * r / 4), abs=0.03)
        assert abs((log[:, r:] * log[:, :-r]).mean() / 0.25) < 0.03
    z_m = tilted(50, 0)
    placed = on_raster(depth_map(z_m), 0.2, line_unevenness=0.5, focal_px=F_PX)
    share = ((placed.depth_m - z_m) / placed.sigma_m)[1:-1, 1:-1]
    assert share.std() == pytest.approx(1, rel=0.03)  # what sigma tells
    size = np.abs(share) - np.abs(share).mean()
    lines, columns = (size[1:] * size[:-1]).mean(), (size[:, 1:] * size[:, :-1]).mean()
    assert lines > 5 * abs(columns)
    assert abs((share[1:] * share[:-1]).mean()) < 0.02  # their signs are not


def test_where_light_is_even_a_place_is_nearer_to_the_middle():
    """Half the contrast of light moves the mean of a window half as far, and sigma tells it."""
    z_m = tilted(45, 0)
    contrast = np.where(np.arange(SHAPE[1]) < 160, 1.0, 0.5) * np.ones(SHAPE)
    placed = on_raster(depth_map(z_m), 0.25, light_contrast=contrast, focal_px=F_PX)
    whole = on_raster(depth_map(z_m), 0.25, focal_px=F_PX)
    moved, alone = placed.depth_m - z_m, whole.depth_m - z_m
    assert np.allclose(moved[:, 160:], 0.5 * alone[:, 160:], rtol=0.01, atol=1e-6)
    assert np.array_equal(moved[:, :160], alone[:, :160])
    inside = np.s_[1:-1, 161:-1]
    assert np.std((moved / placed.sigma_m)[inside]) == pytest.approx(1, rel=0.02)


def test_a_facing_surface_a_step_and_a_hole_stay_as_they_are():
    z_m = np.full(SHAPE, 0.8)
    z_m[:, 160:] = 0.9
    z_m[100:110, 100:110] = np.nan
    placed = on_raster(depth_map(z_m), 0.3, focal_px=F_PX)
    assert np.allclose(placed.depth_m, z_m, rtol=1e-6, equal_nan=True)


def with_lost(z_m, **edge_px):
    return with_faults(
        depth_map(z_m, sigma_m=1e-4), FaultSpec(**edge_px), CAMERA, step_angle_deg=80.0
    )


@pytest.mark.parametrize("azimuth_deg", [0, 90])
@pytest.mark.parametrize("edge_px", [(0.2, 0.6), (0.6, 0.0), (0.0, 0.4)])
def test_beside_a_step_the_share_of_lost_pixels_is_the_width(edge_px, azimuth_deg):
    """Points lie evenly in their pixels, so that share of them is nearer to the step, on either
    side and independently. What is one pixel farther away stays, and so does a hole's rim.
    """
    z_m = tilted(20, azimuth_deg)
    z_m[:, 80:] += 0.05
    z_m[100:, :] += 0.12  # steps along rows and along columns
    z_m[20:30, 20:30] = np.nan
    left = with_lost(z_m, edge_x_px=edge_px[0], edge_y_px=edge_px[1])
    gone = left.reason == Reason.OUTLIER
    assert np.array_equal(np.isnan(left.depth_m), gone | np.isnan(z_m))
    assert np.array_equal(np.isnan(left.sigma_m), gone)
    beside = np.zeros(SHAPE, dtype=bool)
    beside[:, 79:81] = beside[99:101] = True
    assert not gone[~beside].any()
    along_x = np.delete(gone[:, 79:81], np.s_[97:103], axis=0)
    along_y = np.delete(gone[99:101], np.s_[77:83], axis=1).T
    for lost, share in zip((along_x, along_y), edge_px, strict=True):
        assert lost.mean() == pytest.approx(share, abs=4 * _standard_error(share, lost.size))
        both = lost.all(axis=1).mean()
        assert both == pytest.approx(share**2, abs=4 * _standard_error(share**2, len(lost)))


def _standard_error(share: float, count: int) -> float:
    return math.sqrt(share * (1 - share) / count)


def test_lost_edges_are_the_same_in_every_shot_and_steep_surfaces_have_none():
    z_m = np.full(SHAPE, 0.8)
    z_m[:, 80:] += 0.05
    noise_m = 1e-4 * np.random.default_rng(1).standard_normal(SHAPE)
    once, again = (with_lost(shot, edge_x_px=0.4).reason for shot in (z_m, z_m + noise_m))
    assert (once == Reason.OUTLIER).any()
    assert np.array_equal(once, again)
    steep = with_lost(tilted(50, 30), edge_x_px=1.0, edge_y_px=1.0)
    assert (steep.reason == Reason.DECODED).all()


def test_without_a_fault_the_map_is_the_same():
    depth = depth_map(tilted(45, 0))
    for off in (FaultSpec(), FaultSpec(edge_x_px=0.0, edge_y_px=0.0, raster_px=0.0)):
        assert with_faults(depth, off, CAMERA, step_angle_deg=80.0) is depth


@pytest.mark.parametrize(("name", "value"), [("raster_px", 1.5), ("edge_x_px", -0.1)])
def test_impossible_faults_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        FaultSpec(**{name: value})


def test_no_setting_of_a_filter_is_a_fault_and_decode_stack_takes_filters_alone():
    assert not {f.name for f in fields(FaultSpec)} & {f.name for f in fields(FilterSpec)}
    assert get_type_hints(decode_stack)["filters"] == FilterSpec | None
    assert set(get_type_hints(decode_stack)) == {"path", "rig", "average", "filters", "return"}
