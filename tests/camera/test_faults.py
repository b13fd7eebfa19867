"""Faults of a device: depth is measured at points next to the centres of pixels."""

import math
from dataclasses import fields
from typing import get_type_hints

import numpy as np
import pytest
from stage import centred

from graycast.camera.decode import DepthMap, FilterSpec, Reason
from graycast.camera.faults import FaultSpec, line_amplitude, with_faults
from graycast.camera.stack import decode_stack

F_PX, SHAPE = 500.0, (300, 320)


def tilted(tilt_deg, azimuth_deg):
    """Return z of a plane through (0, 0, 0.8), and its slope per pixel."""
    y, x = (np.indices(SHAPE) - np.array([149.5, 159.5])[:, None, None]) / F_PX
    slope = math.tan(math.radians(tilt_deg))
    aside = x * math.cos(math.radians(azimuth_deg)) + y * math.sin(math.radians(azimuth_deg))
    return 0.8 / (1 - slope * aside)


def depth_map(z_m, sigma_m=1e-7):
    return DepthMap(
        depth_m=z_m.astype(np.float32),
        sigma_m=np.full(SHAPE, sigma_m, dtype=np.float32),
        reason=np.full(SHAPE, int(Reason.DECODED), dtype=np.uint8),
        camera=centred(SHAPE[1], SHAPE[0], F_PX),
    )


@pytest.mark.parametrize(("tilt_deg", "azimuth_deg"), [(20, 0), (45, 90), (60, 30)])
def test_the_raster_error_is_proportional_to_the_slope_and_the_pixel_width(tilt_deg, azimuth_deg):
    """A pixel is z / f wide at the axis, a plane rises by tan(tilt) times that; sigma agrees."""
    z_m = tilted(tilt_deg, azimuth_deg)
    placed = with_faults(depth_map(z_m), FaultSpec(raster_px=0.25), seed=0)
    error_m = placed.depth_m - z_m
    near = np.s_[130:170, 140:180]
    law_m = 0.25 * math.tan(math.radians(tilt_deg)) * z_m[near].mean() / F_PX
    assert error_m[near].std() == pytest.approx(law_m, rel=0.08)  # 1600 pixels: 1.8 % one sigma
    inside = np.s_[1:-1, 1:-1]
    assert np.std((error_m / placed.sigma_m)[inside]) == pytest.approx(1, rel=0.02)


@pytest.mark.parametrize("tilt_deg", [5, 30, 70])
def test_the_error_from_a_raster_does_not_exceed_its_limit(tilt_deg):
    """Oracle: the inverse squares of both deviations are added."""
    z_m, limit_m = tilted(tilt_deg, 90), 2e-4
    placed = with_faults(depth_map(z_m), FaultSpec(raster_px=0.25, raster_limit_m=limit_m), seed=0)
    near = np.s_[130:170, 140:180]
    free_m = 0.25 * math.tan(math.radians(tilt_deg)) * z_m[near].mean() / F_PX
    law_m = (free_m**-2 + limit_m**-2) ** -0.5
    assert (placed.depth_m - z_m)[near].std() == pytest.approx(law_m, rel=0.08)
    assert placed.sigma_m[near].mean() == pytest.approx(law_m, rel=0.02)


def test_the_raster_is_white_noise_and_equal_in_every_shot():
    z_m = tilted(45, 30)
    once, again = (with_faults(depth_map(z_m), FaultSpec(raster_px=0.3), seed=0) for _ in range(2))
    assert np.array_equal(once.depth_m, again.depth_m)
    share = ((once.depth_m - z_m) / once.sigma_m)[1:-1, 1:-1]
    for a, b in ((share[1:], share[:-1]), (share[:, 1:], share[:, :-1])):
        assert abs((a * b).mean()) < 4 / math.sqrt(share.size)


def test_raster_errors_along_a_line_have_similar_sizes():
    """Oracle: the log-normal law, whose logarithm is a Gaussian convolved with white noise."""
    factor = line_amplitude((400, 420), 0.5, seed=0)
    assert (factor**2).mean() == pytest.approx(1, rel=0.03)
    log = np.log(factor)
    log -= log.mean()
    assert log.std() == pytest.approx(0.5, rel=0.02)
    for r in (1, 2, 3):
        along = (log[r:] * log[:-r]).mean() / 0.25
        assert along == pytest.approx(math.exp(-r * r / 4), abs=0.03)
        assert abs((log[:, r:] * log[:, :-r]).mean() / 0.25) < 0.03
    z_m = tilted(50, 0)
    placed = with_faults(
        depth_map(z_m), FaultSpec(raster_px=0.2, raster_line_unevenness=0.5), seed=0
    )
    share = ((placed.depth_m - z_m) / placed.sigma_m)[1:-1, 1:-1]
    assert share.std() == pytest.approx(1, rel=0.03)  # the change that sigma includes
    size = np.abs(share) - np.abs(share).mean()
    lines, columns = (size[1:] * size[:-1]).mean(), (size[:, 1:] * size[:, :-1]).mean()
    assert lines > 5 * abs(columns)
    assert abs((share[1:] * share[:-1]).mean()) < 0.02  # The signs of neighbours do not correlate.


def test_half_the_light_contrast_halves_the_raster_error():
    """Half the contrast of the light moves the centre half as far, and sigma agrees."""
    z_m = tilted(45, 0)
    contrast = np.where(np.arange(SHAPE[1]) < 160, 1.0, 0.5) * np.ones(SHAPE)
    placed = with_faults(depth_map(z_m), FaultSpec(raster_px=0.25), seed=0, light_contrast=contrast)
    whole = with_faults(depth_map(z_m), FaultSpec(raster_px=0.25), seed=0)
    moved, alone = placed.depth_m - z_m, whole.depth_m - z_m
    assert np.allclose(moved[:, 160:], 0.5 * alone[:, 160:], rtol=0.01, atol=1e-6)
    assert np.array_equal(moved[:, :160], alone[:, :160])
    inside = np.s_[1:-1, 161:-1]
    assert np.std((moved / placed.sigma_m)[inside]) == pytest.approx(1, rel=0.02)


def test_the_raster_does_not_change_a_facing_surface_a_step_or_a_hole():
    z_m = np.full(SHAPE, 0.8)
    z_m[:, 160:] = 0.9
    z_m[100:110, 100:110] = np.nan
    placed = with_faults(depth_map(z_m), FaultSpec(raster_px=0.3), seed=0)
    assert np.allclose(placed.depth_m, z_m, rtol=1e-6, equal_nan=True)


def test_a_depth_map_without_a_fault_is_returned_unchanged():
    depth = depth_map(tilted(45, 0))
    for off in (FaultSpec(), FaultSpec(raster_px=0.0), FaultSpec(raster_limit_m=1e-4)):
        assert with_faults(depth, off, seed=0) is depth


@pytest.mark.parametrize(("name", "value"), [("raster_px", 1.5), ("raster_limit_m", 0.0)])
def test_the_error_for_an_impossible_fault_names_its_key(name, value):
    with pytest.raises(ValueError, match=name):
        FaultSpec(**{name: value})


def test_decode_stack_accepts_filters_but_no_faults():
    assert not {f.name for f in fields(FaultSpec)} & {f.name for f in fields(FilterSpec)}
    assert get_type_hints(decode_stack)["filters"] == FilterSpec | None
    names = {"path", "rig", "average", "filters", "motion_m", "progress", "return"}
    assert set(get_type_hints(decode_stack)) == names
