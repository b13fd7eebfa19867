"""Fine noise, from tiles and from pairs of maps, of known noise on known surfaces."""

import numpy as np
import pytest

from graycast.real.realism import measure_all, pool
from graycast.real.realism.fine import measure_fine, measure_pair, median_over_mean
from graycast.real.realism.measure import measure_scan

from .synthetic import plane, rays, scan

SIGMA_M = 2e-4


def record(*depth_m, **fields):
    return pool(measure_all(scan(d, **fields) for d in depth_m), name="set")


def sphere(radius_m=0.25, middle_m=0.8):
    """Return z of a sphere in front of the camera, up to an incidence of about 50 degrees."""
    ray = rays()
    unit = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    along = unit[..., 2] * middle_m
    root = along**2 - middle_m**2 + radius_m**2
    return np.where(root > 0.02, (along - np.sqrt(root.clip(min=0))) * unit[..., 2], np.nan)


@pytest.mark.slow
def test_the_median_fine_noise_of_white_noise_is_its_sigma():
    rng = np.random.default_rng(1)
    depth_m = plane(0.4) + SIGMA_M * rng.standard_normal((240, 320))
    fine = record(depth_m).fine
    # There are 1200 tiles, each with about 15 degrees of freedom.
    assert fine.percentiles_m[2] == pytest.approx(SIGMA_M, rel=4 * 1.25 / np.sqrt(30 * 1200))
    assert fine.rough < 0.03


def test_the_ratio_of_median_to_mean_agrees_with_simulated_noise():
    """Oracle: thirty thousand simulated tiles of white noise."""
    noise = np.random.default_rng(2).standard_normal((30_000, 8, 8))
    along = noise[:, :, :-2] - 2 * noise[:, :, 1:-1] + noise[:, :, 2:]
    mixed = (along[:, :-2] - 2 * along[:, 1:-1] + along[:, 2:]) / 6
    power = (mixed**2).mean(axis=(1, 2))
    assert median_over_mean() == pytest.approx(np.median(power) / power.mean(), rel=0.01)


def test_the_noise_of_a_ball_is_measured_without_fitting_planes():
    rng = np.random.default_rng(3)
    depth_m = sphere()
    depth_m = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
    figures = record(depth_m)
    assert figures.noise.bent > 0.9
    assert figures.fine.tiles > 250
    assert figures.fine.percentiles_m[2] == pytest.approx(SIGMA_M, rel=0.03)


def test_fine_noise_is_grouped_by_the_brightness_of_its_pixels():
    rng = np.random.default_rng(6)
    gray = np.full((240, 320), 0.7)
    gray[:, 160:] = 0.05
    depth_m = plane() + np.where(gray > 0.5, 1.0, 2.5) * 1e-4 * rng.standard_normal(gray.shape)
    fine = record(depth_m, gray=gray).fine
    assert fine.dark_to_bright == pytest.approx(2.5, rel=0.05)
    filled = {(b.low, b.high): b for b in fine.by_brightness if b.count}
    assert list(filled) == [(1 / 32, 1 / 16), (0.5, np.nextafter(1.0, 2.0))]
    for (low, _), sigma_m in zip(filled, (2.5e-4, 1e-4), strict=True):
        of = next(b for b in filled.values() if b.low == low)
        assert of.interval[0] < sigma_m < of.interval[1]
        assert of.interval[1] - of.interval[0] < 0.06 * sigma_m


@pytest.mark.slow
def test_the_noise_of_steep_planes_is_compared_with_facing_planes():
    rng = np.random.default_rng(7)
    facing = scan(plane() + 1e-4 * rng.standard_normal((240, 320)))
    steep = plane(np.radians(45))
    steep = scan(steep + 2e-4 * rng.standard_normal(steep.shape))
    fine = pool([measure_scan(facing), measure_scan(steep)], name="both").fine
    assert fine.steep_to_facing == pytest.approx(2.0, rel=0.05)


def test_the_angle_of_incidence_is_between_ray_and_normal():
    tilt_rad = 0.6
    depth_m = plane(tilt_rad) + 1e-7 * np.random.default_rng(5).standard_normal((240, 320))
    fine = measure_fine(scan(depth_m))
    pixel = np.stack(np.meshgrid(np.arange(3.5, 320, 8), np.arange(3.5, 240, 8)), axis=-1)
    ray = np.concatenate([(pixel - [159.5, 119.5]) / 300.0, np.ones((30, 40, 1))], axis=-1)
    normal = np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    expected = np.arccos(ray @ normal / np.linalg.norm(ray, axis=-1)).ravel()
    assert np.sort(fine.incidence_rad) == pytest.approx(np.sort(expected), abs=3e-3)


def test_two_maps_of_a_scene_give_the_independent_noise_and_its_correlation():
    """Shape and fixed pattern cancel; a mean of two neighbours has correlation 1/2 at lag 1."""
    rng = np.random.default_rng(8)
    fixed = plane(0.3) + 3e-4 * rng.standard_normal((240, 320))

    def shot():
        white = rng.standard_normal((241, 320))
        return scan(fixed + SIGMA_M * (white[1:] + white[:-1]) / np.sqrt(2))

    pair = measure_pair(shot(), shot())
    assert pair.sigma_m == pytest.approx(SIGMA_M, rel=0.02)
    assert pair.along_columns == pytest.approx((0.5, 0, 0), abs=0.02)
    assert pair.along_rows == pytest.approx((0, 0, 0), abs=0.02)


def test_movement_between_two_maps_is_not_counted_as_noise():
    rng = np.random.default_rng(9)
    first, second = (plane() + SIGMA_M * rng.standard_normal((240, 320)) for _ in range(2))
    second[60:160, 100:220] -= 0.05
    pair = measure_pair(scan(first), scan(second))
    assert pair.sigma_m == pytest.approx(SIGMA_M, rel=0.02)
    assert pair.pixels < 240 * 320 - 100 * 120 + 1


def test_maps_from_two_cameras_are_not_accepted_as_a_pair():
    other = scan(plane(), K=np.array([[310.0, 0, 159.5], [0, 310.0, 119.5], [0, 0, 1]]))
    assert measure_pair(scan(plane()), other) is None
    assert pool([measure_scan(scan(plane()))], name="one").pairs.sigma_m is None


def test_islands_of_missing_pixels_are_counted_by_size():
    depth_m = np.full((60, 60), 0.5)
    depth_m[5, 5] = depth_m[20, 20:23] = depth_m[40, 10:17] = np.nan
    depth_m[30, 40:45] = np.nan
    islands = record(depth_m, depth_m).islands
    assert islands.holes_by_size == {"1": 1.0, "2 to 4": 1.0, "5 to 10": 2.0}
    assert sum(islands.holes_by_size.values()) == islands.holes
