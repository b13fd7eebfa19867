"""Missing pixels, drop-out and islands in maps where their numbers are known."""

import numpy as np
import pytest

from graycast.real.realism import DepthScan, pool
from graycast.real.realism.measure import measure_scan

from .synthetic import K, plane, scan


def record(*scans):
    return pool([measure_scan(s) for s in scans], name="set")


@pytest.mark.slow
def test_shares_of_missing_pixels_refer_to_all_pixels_of_all_maps():
    full, half = plane(), plane()
    half = np.concatenate([half[:120], np.full_like(half[:120], np.nan)])
    assert record(scan(full), scan(half)).missing.share == 0.25


@pytest.mark.slow
def test_reasons_are_counted_for_missing_pixels_only():
    depth_m = plane()
    depth_m[:24] = np.nan
    depth_m[24:36] = np.nan
    reason = np.zeros(depth_m.shape, dtype=np.uint8)
    reason[:24], reason[24:36], reason[36:] = 1, 7, 2  # 2 has depth and must be ignored.
    figures = record(scan(depth_m, reason=reason, reason_names={1: "SHADOW", 2: "SATURATED"}))
    assert figures.missing.by_reason == {"shadow": 0.1, "reason 7": 0.05}


@pytest.mark.slow
def test_the_drop_out_step_is_found_at_its_level_with_its_shares():
    """In a ramp of brightness, 90 % of the pixels are missing below 0.04 and 2 % above."""
    rng = np.random.default_rng(1)
    depth_m = plane(height_px=400, width_px=600)
    gray = np.round(255 * np.linspace(0, 0.3, depth_m.size)).reshape(depth_m.shape) / 255
    share = np.where(gray < 0.04, 0.9, 0.02)
    depth_m[rng.random(depth_m.shape) < share] = np.nan
    drop = record(scan(depth_m, gray=gray)).missing.drop_out
    assert abs(drop.brightness - 0.04) <= 1 / 255
    assert drop.last - drop.first <= 1 / 255
    assert drop.missing_below == pytest.approx(0.9, abs=4 * 0.3 / np.sqrt(0.04 / 0.3 * 240_000))
    assert drop.missing_above == pytest.approx(0.02, abs=4 * 0.14 / np.sqrt(0.26 / 0.3 * 240_000))


@pytest.mark.slow
def test_the_width_of_a_gradual_drop_out_is_measured():
    """The missing share falls from 1 at a brightness of 0.05 to 0 at 0.15, linearly."""
    rng = np.random.default_rng(2)
    depth_m = plane(height_px=800, width_px=600)
    gray = rng.uniform(0, 0.3, depth_m.shape)
    depth_m[rng.random(depth_m.shape) < np.clip((0.15 - gray) / 0.1, 0, 1)] = np.nan
    drop = record(scan(depth_m, gray=gray)).missing.drop_out
    assert drop.brightness == pytest.approx(0.1, abs=0.01)
    assert drop.last - drop.first == pytest.approx(0.05, abs=0.015)


def test_missing_pixels_that_do_not_depend_on_brightness_show_no_drop_out_step():
    rng = np.random.default_rng(3)
    depth_m, gray = plane(), rng.uniform(0, 1, plane().shape)
    depth_m[rng.random(depth_m.shape) < 0.3] = np.nan
    missing = record(scan(depth_m, gray=gray)).missing
    assert missing.drop_out is None
    assert sum(b.count for b in missing.by_brightness) == depth_m.size
    for one in missing.by_brightness:
        assert one.value == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / one.count))


def test_islands_are_counted_up_to_ten_pixels():
    """The map has holes in a plane and isolated specks of 1 to 20 pixels."""
    depth_m = np.concatenate([plane(), np.full_like(plane(), np.nan)])
    sizes = [1, 2, 5, 10, 11, 20]
    for i, size in enumerate(sizes):
        depth_m[20, 10 + 30 * i : 10 + 30 * i + size] = np.nan
        depth_m[300, 10 + 30 * i : 10 + 30 * i + size] = 0.5
    depth_m[100, 100] = depth_m[101, 101] = np.nan  # one hole, because pixels touch at a corner
    # These islands may continue beyond the border.
    depth_m[0, 5] = depth_m[60, 0] = depth_m[60, -1] = np.nan
    depth_m[-1, 5] = depth_m[400, 0] = depth_m[400, -1] = 0.5
    islands = record(scan(depth_m)).islands
    assert (islands.holes, islands.specks) == (5, 4)
    assert islands.hole_share == pytest.approx((1 + 2 + 5 + 10 + 2) / depth_m.size)
    assert islands.speck_share == pytest.approx((1 + 2 + 5 + 10) / depth_m.size)


def test_arrays_that_cannot_be_depth_are_refused():
    with pytest.raises(ValueError, match="write NaN"):
        scan(np.zeros((4, 4)))
    with pytest.raises(ValueError, match="0 to 1"):
        scan(plane(), gray=np.full(plane().shape, 255.0))
    with pytest.raises(ValueError, match="focal lengths"):
        DepthScan(name="x", depth_m=plane(), K=0 * K)
