"""Fused clouds of several views, against planes and spheres in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from seen import FINE, from_above, plane_depth, sphere_depth, view

from graycast.score.merge import HIDDEN, OUTSIDE, fuse

UP = np.array([0.0, 0.0, 1.0])
SIGMA_M = 0.2e-3


def noisy(depth_m, rng, sigma_m=SIGMA_M):
    return depth_m + sigma_m * rng.standard_normal(depth_m.shape)


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow), 5])
def test_sigma_of_equal_views_falls_with_the_root_of_their_number(count):
    """Oracle: the standard error of a mean, for the stated sigma and for the actual scatter."""
    T, rng = from_above(0.0), np.random.default_rng(count)
    depth_m = plane_depth(T, UP, 0.0)
    one = fuse([view(depth_m, T, SIGMA_M)]).cloud
    many = fuse([view(noisy(depth_m, rng), T, SIGMA_M) for _ in range(count)]).cloud
    inner = (many.views == count) & (np.abs(many.normal[:, 2]) > 0.9)
    assert inner.mean() > 0.97
    assert one.sigma_m.min() == pytest.approx(SIGMA_M, rel=1e-3)
    assert np.median(many.sigma_m[inner]) == pytest.approx(SIGMA_M / np.sqrt(count), rel=0.02)
    scatter_m = many.point_m[inner, 2].std()
    # The scatter of n values has a relative error of 1 / sqrt(2 n), which is 1 % here.
    assert scatter_m == pytest.approx(SIGMA_M / np.sqrt(count), rel=4 / np.sqrt(2 * inner.sum()))


def test_a_fused_slanted_plane_is_correct_within_its_stated_sigma():
    """Oracle: errors divided by the stated sigma have a variance of one."""
    rng, normal = np.random.default_rng(7), np.array([0.2, -0.1, 1.0]) / np.sqrt(1.05)
    places = [from_above(-0.45), from_above(0.4, 0.3, 0.9)]
    views = [view(noisy(plane_depth(T, normal, 0.02), rng), T, SIGMA_M) for T in places]
    cloud = fuse(views).cloud
    off = (cloud.point_m @ normal - 0.02) / cloud.sigma_m
    both = cloud.views == 2
    assert both.mean() > 0.4 and not cloud.against.any()
    for group in (both, ~both):
        # Normals have errors of 3 degrees; half a pixel to the side, this is a third of sigma.
        assert np.mean(off[group] ** 2) == pytest.approx(1.0, abs=0.15)


def test_weights_are_inverse_variances():
    """Oracle: 1 / s^2 = 1 / a^2 + 1 / b^2; the mean is closer to the better view."""
    T = from_above(0.0)
    depth_m = plane_depth(T, UP, 0.0)
    good, bad = view(depth_m, T, 0.1e-3), view(depth_m - 0.5e-3, T, 0.3e-3)
    cloud = fuse([good, bad]).cloud
    middle = (np.abs(cloud.pixel - [30, 40]) <= 1).all(axis=1)
    assert cloud.sigma_m[middle] == pytest.approx(np.sqrt(1 / (1e8 + 1e8 / 9)), rel=1e-3)
    assert cloud.point_m[middle, 2] == pytest.approx(0.5e-3 / 10, rel=0.01)


def doubted(one, p_wrong):
    return replace(one, p_wrong=np.full(one.depth_m.shape, p_wrong, np.float32))


def test_a_view_that_is_probably_wrong_hardly_moves_the_mean():
    """Oracle: weights 1 and 1 - 0.9, in the mean and in the variance of a weighted mean."""
    T = from_above(0.0)
    depth_m = plane_depth(T, UP, 0.0)
    right, wrong = view(depth_m, T, SIGMA_M), view(depth_m - 0.8e-3, T, SIGMA_M)
    cloud = fuse([doubted(right, 0.0), doubted(wrong, 0.9)]).cloud
    middle = (np.abs(cloud.pixel - [30, 40]) <= 1).all(axis=1)
    assert (cloud.views[middle] == 2).all()
    assert cloud.point_m[middle, 2] == pytest.approx(0.8e-3 * 0.1 / 1.1, rel=0.01)
    expected = SIGMA_M * np.sqrt(1 + 0.1**2) / 1.1
    assert cloud.sigma_m[middle] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("p_wrong", [0.0, 0.3, 1.0])
def test_equal_doubt_in_all_views_changes_no_point(p_wrong):
    T, rng = from_above(0.0), np.random.default_rng(5)
    views = [view(noisy(plane_depth(T, UP, 0.0), rng), T, SIGMA_M) for _ in range(2)]
    plain, doubtful = fuse(views).cloud, fuse([doubted(one, p_wrong) for one in views]).cloud
    np.testing.assert_allclose(doubtful.point_m, plain.point_m, atol=1e-9)
    np.testing.assert_allclose(doubtful.sigma_m, plain.sigma_m, rtol=1e-5)


def test_a_point_seen_by_several_views_is_in_the_cloud_once():
    """For two views of a plane, the cloud has the finer view's points, and others outside it."""
    near, far = from_above(0.0, z_m=0.5), from_above(0.0, z_m=1.0)
    views = [view(plane_depth(T, UP, 0.0), T, SIGMA_M) for T in (far, near)]
    cloud = fuse(views).cloud
    assert (cloud.view == 1).sum() == 80 * 60
    beyond = cloud.point_m[cloud.view == 0]
    inside = (np.abs(beyond[:, 0]) < 0.19) & (np.abs(beyond[:, 1]) < 0.14)  # inside the near view
    assert not inside.any() and len(beyond) > 0.7 * 80 * 60
    assert (cloud.first_reason == 0).all()


def test_the_view_with_the_smaller_pixels_on_the_surface_determines_the_points():
    """The near view leans by 60 degrees: its pixel covers 0.9^2 / cos 60 = 1.6 of the other's."""
    upright, leaning = from_above(0.0), from_above(0.9 * np.sin(np.pi / 3), z_m=0.45)
    views = [view(plane_depth(T, UP, 0.0), T, SIGMA_M) for T in (leaning, upright)]
    cloud = fuse(views).cloud
    near = np.linalg.norm(cloud.point_m, axis=1) < 0.1
    assert (cloud.views[near] == 2).all() and (cloud.view[near] == 1).all()


def test_a_flying_point_that_another_view_sees_through_is_rejected():
    rng = np.random.default_rng(3)
    left, right = from_above(-0.4), from_above(0.4)
    flying = noisy(plane_depth(left, UP, 0.0), rng)
    flying[20:40:4, 30:50:4] -= 0.05  # single pixels, 5 cm above the plane
    views = [
        view(flying, left, SIGMA_M),
        view(noisy(plane_depth(right, UP, 0.0), rng), right, SIGMA_M),
    ]
    fused = fuse(views)
    assert fused.rejected_px == (25, 0)
    assert fused.cloud.point_m[:, 2].max() < 6 * SIGMA_M
    alone = fuse(views[:1])  # Without another view, nothing contradicts these pixels.
    assert alone.rejected_px == (0,) and (alone.cloud.point_m[:, 2] > 0.03).sum() == 25


@pytest.mark.slow
def test_a_point_hidden_from_another_view_is_not_rejected():
    """Each view sees an area of the plane that the ball hides from the other view."""
    places = [from_above(-0.5), from_above(0.5)]
    ball = [sphere_depth(T, (0.0, 0.0, 0.1), 0.06, FINE) for T in places]
    views = [
        view(np.fmin(b, plane_depth(T, UP, 0.0, FINE)), T, SIGMA_M, camera=FINE)
        for T, b in zip(places, ball, strict=True)
    ]
    fused = fuse(views)
    assert fused.rejected_px == (0, 0) and not fused.cloud.against.any()
    cloud = fused.cloud
    on_ball = np.abs(np.linalg.norm(cloud.point_m - [0, 0, 0.1], axis=1) - 0.06) < 1e-3
    on_plane = np.abs(cloud.point_m[:, 2]) < 1e-3
    assert (on_ball | on_plane).all()
    assert (cloud.first_reason[on_plane & (cloud.view == 1)] == HIDDEN).sum() > 50


def test_a_hole_filled_by_another_view_keeps_the_first_views_reason():
    left, right = from_above(-0.3), from_above(0.3)
    holed = plane_depth(left, UP, 0.0)
    holed[20:40, 20:40] = np.nan
    views = [
        view(holed, left, SIGMA_M, reason=3),
        view(plane_depth(right, UP, 0.0), right, SIGMA_M),
    ]
    cloud = fuse(views).cloud
    filled = cloud.first_reason == 3
    assert filled.sum() == pytest.approx(400, rel=0.15)  # The pixels of both views are similar.
    assert set(cloud.first_reason.tolist()) == {0, 3, OUTSIDE}
    assert (cloud.views[filled] == 1).all() and (cloud.view[filled] == 1).all()


def test_two_sides_of_a_thin_sheet_stay_separate():
    """The distance of the sides is below the noise, but their normals differ."""
    above, below = from_above(0.0, 0.001, 1.0), from_above(0.0, 0.001, -1.0)
    views = [
        view(plane_depth(above, UP, 0.2e-3), above, SIGMA_M),
        view(plane_depth(below, UP, -0.2e-3), below, SIGMA_M),
    ]
    assert (fuse(views).cloud.views == 1).all()


def test_a_view_without_depth_adds_no_points():
    T = from_above(0.0)
    dark = view(np.full((60, 80), np.nan), T, SIGMA_M, reason=1)
    fused = fuse([dark, view(plane_depth(T, UP, 0.0), T, SIGMA_M)])
    assert fused.measured_px == (0, 4800)
    assert (fused.cloud.first_reason == 1).all()
