"""Noise about planes, of noise with known size and correlation on known surfaces."""

import numpy as np
import pytest
from backends import slow
from scipy import ndimage

from graycast.real.realism import pool
from graycast.real.realism.measure import measure_scan
from graycast.real.realism.noise import LAGS, autocorrelation, measure_noise

from .synthetic import WIDTH_PX, plane, rays, scan

SIGMA_M = 2e-4
FREEDOM = 15 * 15 - 3
SIZE_PX = (300, 420)
PATCHES = 20 * 28


def noise_like(shape, rng, kernel=None):
    """Return noise of unit variance that is correlated by a kernel."""
    if kernel is None:
        return rng.standard_normal(shape)
    white = rng.standard_normal(np.add(shape, 20))
    kernel = kernel / np.sqrt((kernel**2).sum())
    return ndimage.convolve(white, kernel)[10:-10, 10:-10]


def noisy_plane(rng, kernel=None, tilt_rad=0.0, sigma_m=SIGMA_M, size=SIZE_PX):
    depth_m = plane(tilt_rad, height_px=size[0], width_px=size[1])
    return depth_m + sigma_m * noise_like(depth_m.shape, rng, kernel)


def test_white_noise_on_a_plane_is_measured_with_its_sigma():
    noise = measure_noise(scan(noisy_plane(np.random.default_rng(1))))
    variance = (noise.sigma_m**2).mean() / SIGMA_M**2
    standard_error = np.sqrt(2 / (FREEDOM * len(noise.sigma_m)))
    assert len(noise.sigma_m) >= 0.99 * PATCHES
    assert abs(variance - 1) < 4 * standard_error


def test_the_scatter_between_patches_follows_a_chi_square_distribution():
    sigma_m = measure_noise(scan(noisy_plane(np.random.default_rng(2)))).sigma_m
    expected = SIGMA_M / np.sqrt(2 * FREEDOM)
    assert sigma_m.std() == pytest.approx(expected, rel=4 / np.sqrt(2 * len(sigma_m)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "rows", "columns"),
    [
        slow(np.ones((1, 1)), (0, 0, 0), (0, 0, 0)),
        slow(np.ones((3, 3)), (2 / 3, 1 / 3, 0), (2 / 3, 1 / 3, 0)),
        slow(np.ones((1, 2)), (1 / 2, 0, 0), (0, 0, 0)),
        slow(np.array([[1.0], [2.0], [1.0]]), (0, 0, 0), (4 / 6, 1 / 6, 0)),
        (np.ones((5, 5)), (4 / 5, 3 / 5, 2 / 5), (4 / 5, 3 / 5, 2 / 5)),
    ],
    ids=["white", "3x3 box", "pairs along rows", "1 2 1 along columns", "5x5 box"],
)
def test_filtered_noise_has_the_autocorrelation_of_its_filter(kernel, rows, columns):
    """Oracle: the autocorrelation of the kernel. Without a correction, a 3 x 3 box gives 0.62."""
    record = pool([measure_scan(scan(noisy_plane(np.random.default_rng(3), kernel)))], name="plane")
    tolerance = 4 * np.sqrt(kernel.size**2 / kernel.size / np.prod(SIZE_PX)) + 1e-3
    assert record.autocorrelation.along_rows == pytest.approx(rows, abs=2 * tolerance)
    assert record.autocorrelation.along_columns == pytest.approx(columns, abs=2 * tolerance)


@pytest.mark.parametrize("side", [3, 5])
def test_correlated_noise_keeps_its_sigma_and_its_patches(side):
    noise = measure_noise(scan(noisy_plane(np.random.default_rng(4), np.ones((side, side)))))
    assert len(noise.sigma_m) >= 0.97 * noise.candidates
    # With a box of s x s, a patch has about 15^2 / s^2 independent values.
    standard_error = np.sqrt(2 / (15**2 / side**2) / len(noise.sigma_m))
    assert abs((noise.sigma_m**2).mean() / SIGMA_M**2 - 1) < 4 * standard_error


@pytest.mark.slow
def test_flat_patches_are_taken_from_a_plane_and_not_from_a_sphere():
    """A patch on the sphere has a sagitta of (15 z / f)^2 / (8 R) = 1.3 mm, 6.5 sigma."""
    rng = np.random.default_rng(8)
    ray, radius_m, middle = rays(), 0.06, np.array([0.0, 0.0, 0.56])
    unit = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    along = unit @ middle
    root = along**2 - middle @ middle + radius_m**2
    sphere_m = np.where(root > 0, (along - np.sqrt(root.clip(min=0))) * unit[..., 2], np.nan)
    noise_m = SIGMA_M * rng.standard_normal(sphere_m.shape)
    assert measure_noise(scan(sphere_m + noise_m)).candidates > 5
    both_m = np.concatenate([sphere_m + noise_m, plane(height_px=600) + SIGMA_M
                             * rng.standard_normal((600, WIDTH_PX))])  # fmt: skip
    noise = measure_noise(scan(both_m))
    planes = 40 * (WIDTH_PX // 15)
    assert 0.98 * planes <= len(noise.sigma_m) <= planes
    assert np.median(noise.sigma_m) == pytest.approx(SIGMA_M, rel=0.01)


def test_patches_with_an_edge_are_left_out():
    """Every 25 columns, there is a step of 4 sigma; only patches between the steps are used."""
    rng = np.random.default_rng(9)
    columns = np.arange(SIZE_PX[1])
    depth_m = noisy_plane(rng) + 4 * SIGMA_M * ((columns // 25) % 2)
    noise = measure_noise(scan(depth_m))
    clear = np.mean(
        [len({c // 25 for c in range(x, x + 15)}) == 1 for x in range(0, SIZE_PX[1], 15)]
    )
    assert len(noise.sigma_m) == pytest.approx(clear * noise.candidates, rel=0.15)
    assert np.median(noise.sigma_m) == pytest.approx(SIGMA_M, rel=0.02)


@pytest.mark.slow
def test_spikes_and_holes_do_not_spoil_a_patch():
    rng = np.random.default_rng(10)
    depth_m = noisy_plane(rng)
    pick = rng.random(depth_m.shape)
    depth_m[pick < 0.01] += 0.02
    depth_m[pick > 0.98] = np.nan
    record = pool([measure_scan(scan(depth_m))], name="spiky").noise
    assert record.percentiles_m[2] == pytest.approx(SIGMA_M, rel=0.01)
    assert record.outliers == pytest.approx(0.01 / 0.98, rel=0.05)
    assert record.bent < 0.02


def test_the_correction_for_the_fit_is_exact_in_expectation():
    """Oracle: the covariance of residuals, computed with explicit projection matrices."""
    y, x = np.divmod(np.arange(225), 15)
    design = np.stack([np.ones(225), x, y], axis=1).astype(float)
    left = np.eye(225) - design @ np.linalg.pinv(design)
    distance = np.abs(x[:, None] - x), np.abs(y[:, None] - y)
    truth = np.clip(1 - distance[0] / 4, 0, None) * np.clip(1 - distance[1] / 3, 0, None)
    residual = left @ truth @ left
    products = []
    for dx, dy in LAGS:
        pairs = (x[None] - x[:, None] == dx) & (y[None] - y[:, None] == dy)
        products.append(residual[pairs].mean())
    expected = [max(1 - abs(dx) / 4, 0) * max(1 - dy / 3, 0) for dx, dy in LAGS]
    assert autocorrelation(np.array(products)) == pytest.approx(expected, abs=1e-9)


def test_a_map_without_a_flat_patch_has_no_noise_figures():
    record = pool([measure_scan(scan(np.full((40, 50), np.nan)))], name="empty")
    assert record.noise.percentiles_m is None
    assert record.autocorrelation.along_rows is None
    assert record.missing.share == 1.0
