"""Depth jumps, flying pixels and the baseline, in maps of plates in front of a wall."""

import numpy as np
import pytest
from backends import slow

from graycast.real.realism.depth_steps import count_steps, flying_pixels
from graycast.real.realism.gaps import estimate_baseline, find_gaps

from .synthetic import K, plane, plates, scan, scattered_plates

# For each side of the projector: its position, and the direction of jumps that are in shadow.
SIDES = {
    "right": ((0.2, 0.0, 0.0), "left_farther"),
    "left": ((-0.2, 0.0, 0.0), "right_farther"),
    "below": ((0.0, 0.2, 0.0), "above_farther"),
    "above": ((0.0, -0.2, 0.0), "below_farther"),
}
DIRECTIONS = {"right_farther", "left_farther", "below_farther", "above_farther"}


def baseline(scans):
    rows, columns = zip(*(find_gaps(s) for s in scans), strict=True)
    return estimate_baseline(rows, columns, None)


@pytest.mark.parametrize("side", SIDES)
def test_depth_jumps_are_on_every_side_except_the_side_of_the_shadow(side):
    """A plate has a jump in each row or column, except on the side of its shadow."""
    projector_m, shadowed = SIDES[side]
    depth_m = plates(projector_m, [(-0.1, -0.1, 0.12, 0.08, 0.9)])
    counts = count_steps(scan(depth_m))
    inside = depth_m == 0.9
    rows, columns = int(inside.any(axis=1).sum()), int(inside.any(axis=0).sum())
    lit = {"right_farther": rows, "left_farther": rows,
           "below_farther": columns, "above_farther": columns}  # fmt: skip
    assert {name: getattr(counts, name) for name in DIRECTIONS} == lit | {shadowed: 0}
    assert counts.flying == 0


@pytest.mark.parametrize("side", SIDES)
def test_the_width_of_a_gap_follows_its_formula(side):
    """The width is f b (1/z_near - 1/z_far), up to a pixel of rounding at the rims."""
    projector_m, _ = SIDES[side]
    gaps = find_gaps(scan(plates(projector_m, [(-0.1, -0.1, 0.12, 0.08, 0.9)])))
    rims = gaps[0] if side in ("right", "left") else gaps[1]
    width_px = np.abs(rims.near - rims.far) * K[0, 0]
    assert len(width_px) > 50
    assert width_px == pytest.approx(300 * 0.2 * (1 / 0.9 - 1 / 1.0), abs=1.0)


@pytest.mark.parametrize(
    ("side", "forward_m"),
    [(side, 0.05) for side in SIDES]
    + [("right", 0.0)]
    + [slow(side, 0.0) for side in SIDES if side != "right"],
)
def test_shadows_show_the_side_and_length_of_the_baseline(side, forward_m):
    projector_m = (*SIDES[side][0][:2], forward_m)
    rng = np.random.default_rng(1)
    scans = [scan(plates(projector_m, scattered_plates(rng))) for _ in range(6)]
    estimate = baseline(scans)
    assert estimate.side == side
    assert estimate.agreeing > 0.9
    assert estimate.baseline_m == pytest.approx(np.hypot(0.2, forward_m), rel=0.06)
    assert abs(estimate.baseline_m - np.hypot(0.2, forward_m)) < 2 * estimate.error_m
    if forward_m == 0:
        assert estimate.plain_m == pytest.approx(0.2, rel=0.05)
    assert abs(estimate.eaten_px) < 0.5


def test_rims_removed_by_a_filter_do_not_change_the_baseline():
    """Gaps are two pixels wider on both sides, so the plain baseline is 20 to 40 % too long."""
    rng = np.random.default_rng(2)
    scans = []
    for _ in range(6):
        depth_m = plates((0.2, 0.0, 0.0), scattered_plates(rng))
        missing = np.isnan(depth_m)
        eaten = missing.copy()
        for shift in (-2, -1, 1, 2):
            eaten |= np.roll(missing, shift, axis=1)
        scans.append(scan(np.where(eaten, np.nan, depth_m)))
    estimate = baseline(scans)
    assert estimate.baseline_m == pytest.approx(0.2, rel=0.15)
    assert estimate.eaten_px == pytest.approx(4.0, abs=1.5)
    assert estimate.plain_m > 1.15 * 0.2


def test_random_holes_give_no_estimate_of_the_baseline():
    rng = np.random.default_rng(3)
    # A projector at the camera casts no visible shadow.
    depth_m = plates((0.0, 0.0, 0.0), scattered_plates(rng))
    assert not np.isnan(depth_m).any()
    for _ in range(400):
        y, x, n = *rng.integers(0, (230, 290)), rng.integers(5, 30)
        depth_m[y : y + 3, x : x + n] = np.nan
    assert baseline([scan(depth_m)]) is None


def test_flying_pixels_are_counted_individually():
    """In every second row, the rim of a plate has a pixel between plate and wall."""
    depth_m = plates((-0.2, 0.0, 0.0), [(-0.1, -0.1, 0.12, 0.08, 0.8)])
    clean = count_steps(scan(depth_m))
    y, x = np.nonzero(depth_m == 0.8)
    left = x.min()
    rows = np.arange(y.min() + 4, y.max() - 4, 2)
    flying_m = depth_m.copy()
    flying_m[rows, left - 1] = 0.9
    counts = count_steps(scan(flying_m))
    assert clean.flying == 0 and clean.step_pixels > 0
    assert counts.flying == len(rows)


def test_flying_pixels_at_the_rim_of_a_shadow_are_counted_too():
    depth_m = plates((0.2, 0.0, 0.0), [(-0.1, -0.1, 0.12, 0.08, 0.8)])
    y, x = np.nonzero(depth_m == 0.8)
    rows = np.arange(y.min() + 4, y.max() - 4, 2)
    assert np.isnan(depth_m[rows, x.min() - 1]).all()
    depth_m[rows, x.min() - 1] = 0.9
    assert count_steps(scan(depth_m)).flying == len(rows)


def test_a_jump_that_contains_a_flying_pixel_counts_once():
    depth_m = plates((-0.2, 0.0, 0.0), [(-0.1, -0.1, 0.12, 0.08, 0.8)])
    before = count_steps(scan(depth_m.copy()))
    y, x = np.nonzero(depth_m == 0.8)
    depth_m[np.arange(y.min() + 4, y.max() - 4), x.min() - 1] = 0.9
    after = count_steps(scan(depth_m))
    assert after.left_farther == before.left_farther > 0


@pytest.mark.parametrize("tilt_deg", [60, 75, 80])
def test_a_steep_plane_with_holes_has_neither_jumps_nor_flying_pixels(tilt_deg):
    rng = np.random.default_rng(4)
    depth_m = plane(np.radians(tilt_deg), width_px=200)
    depth_m = np.where((depth_m > 0.1) & (depth_m < 3), depth_m, np.nan)
    depth_m[rng.random(depth_m.shape) < 0.2] = np.nan
    counts = count_steps(scan(depth_m))
    assert counts.right_farther + counts.left_farther + counts.flying == 0


def test_jumps_do_not_depend_on_the_unit_of_length():
    """All lengths times seven give the same picture and the same counts."""
    depth_m = plates((0.2, 0.0, 0.0), scattered_plates(np.random.default_rng(5)))
    assert count_steps(scan(depth_m)) == count_steps(scan(7 * depth_m))


def test_a_mirrored_map_has_mirrored_jumps():
    depth_m = plates((0.2, 0.0, 0.0), scattered_plates(np.random.default_rng(6)))
    there, back = count_steps(scan(depth_m)), count_steps(scan(depth_m[:, ::-1].copy()))
    assert (there.right_farther, there.left_farther) == (back.left_farther, back.right_farther)
    assert (there.flying, there.below_farther) == (back.flying, back.below_farther)


def test_an_outlier_beyond_the_two_surfaces_is_not_a_flying_pixel():
    """The outlier is wrong, but it is not between the surfaces."""
    depth_m = plates((-0.2, 0.0, 0.0), [(-0.1, -0.1, 0.12, 0.08, 0.8)])
    y, x = np.nonzero(depth_m == 0.8)
    rows = np.arange(y.min() + 4, y.max() - 4, 4)
    depth_m[rows, x.min() - 1] = 0.7
    depth_m[rows + 2, x.min() - 1] = 1.1
    assert count_steps(scan(depth_m)).flying == 0


@pytest.mark.parametrize("filled", [0.04, 0.1, 0.5])
def test_a_map_of_isolated_pixels_causes_no_numerical_warning(filled):
    """Valid pixels at the end of a row and at the start of the next row must not be combined.

    Oracle: each row alone.
    """
    rng = np.random.default_rng(5)
    depth_m = np.where(rng.random((60, 24)) < filled, rng.choice([0.8, 0.7], (60, 24)), np.nan)
    depth_m[20:40, 6:18] = np.where(np.arange(12) < 6, 0.8, 0.7)
    counts = count_steps(scan(depth_m))
    rows = [flying_pixels(1 / row[None], scan(depth_m).jump_share) for row in depth_m]
    whole = flying_pixels(1 / depth_m, scan(depth_m).jump_share)
    assert counts.step_pixels >= whole[0].sum() > 0
    for k in (0, 1):
        assert np.array_equal(whole[k], np.concatenate([row[k] for row in rows]))
