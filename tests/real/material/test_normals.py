"""Smooth normals of a depth map, against planes and a sphere whose normals are known."""

import numpy as np
from stage import optics

from graycast.real.material.normals import smooth_normals
from graycast.rig.optics import picture_rays

CAMERA = optics(160, 120, 200)
SIGMA_PER_M = 2e-4  # Noise of inverse depth


def plane_depth_m(normal, offset_m):
    return offset_m / (picture_rays(CAMERA) @ normal)


def noisy(depth_m, seed=0):
    rng = np.random.default_rng(seed)
    return 1 / (1 / depth_m + SIGMA_PER_M * rng.normal(size=depth_m.shape))


def angles_rad(normals, truth):
    return np.arccos(np.clip((normals.normal * truth).sum(axis=-1), -1, 1))


def test_the_errors_of_plane_normals_agree_with_their_stated_sigma():
    """Two independent axes of sigma each have a mean squared angle of 2 sigma^2 together."""
    normal = np.array([0.3, -0.4, -0.866])
    normal /= np.linalg.norm(normal)
    normals = smooth_normals(CAMERA, noisy(plane_depth_m(normal, -0.5)), np.ones((120, 160), bool))
    angle, sigma = angles_rad(normals, normal), normals.sigma_rad
    known = np.isfinite(sigma)
    assert known.mean() > 0.95
    ratio = np.sqrt((angle[known] ** 2).mean() / (2 * sigma[known] ** 2).mean())
    assert 0.8 < ratio < 1.25


def test_normals_of_a_roof_are_not_mixed_across_its_ridge():
    """Planes of 90 degrees meet in a vertical ridge: no normal is a mixture of both."""
    sides = [np.array([sign * np.sqrt(0.5), 0.0, -np.sqrt(0.5)]) for sign in (-1, 1)]
    depth_m = np.maximum(*(plane_depth_m(side, -0.4) for side in sides))
    normals = smooth_normals(CAMERA, noisy(depth_m), np.ones((120, 160), bool))
    known = np.isfinite(normals.sigma_rad)
    nearest = np.minimum(*(angles_rad(normals, side) for side in sides))[known]
    assert known.mean() > 0.8
    assert np.quantile(nearest, 0.99) < np.radians(3)


def test_normals_of_a_ball_point_away_from_its_centre():
    """A ball of 60 mm; the oracle is the line from its middle through each point."""
    ray = picture_rays(CAMERA)
    middle = np.array([0.01, -0.02, 0.5])
    square = (ray * ray).sum(axis=-1)
    along = ray @ middle / square
    inside = along**2 - (middle @ middle - 0.06**2) / square
    depth_m = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), np.nan)
    truth = (ray * depth_m[..., None] - middle) / 0.06
    normals = smooth_normals(CAMERA, noisy(depth_m), np.isfinite(depth_m))
    steep = np.isfinite(normals.sigma_rad) & ((truth * ray).sum(axis=-1) < -0.5)
    assert steep.sum() > 500
    assert np.quantile(angles_rad(normals, truth)[steep], 0.9) < np.radians(5)


def test_pixels_outside_the_mask_have_no_normal_and_affect_no_normal():
    depth_m = plane_depth_m(np.array([0.0, 0.0, -1.0]), -0.5)
    inside = np.zeros(depth_m.shape, bool)
    inside[:, 80:] = True
    depth_m[:, :80] = 0.3
    normals = smooth_normals(CAMERA, noisy(depth_m), inside)
    assert not np.isfinite(normals.sigma_rad[:, :80]).any()
    angle = angles_rad(normals, np.array([0.0, 0.0, -1.0]))[:, 80:]
    assert np.isfinite(angle).mean() > 0.95
    assert np.nanmax(angle) < np.radians(4)
