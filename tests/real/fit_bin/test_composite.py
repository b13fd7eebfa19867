"""The view of an empty bin, composed from views of the bin with parts."""

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.real.fit_bin import empty_view
from graycast.real.fit_bin.bin_views import BinView, farthest_shared
from graycast.rig.optics import Optics

H, W = 60, 80
CAMERA = Optics(width_px=W, height_px=H, fx_px=80.0, fy_px=80.0, cx_px=39.5, cy_px=29.5)


def cluttered(count, rng, sigma_m=2e-4):
    """Return a tilted floor, and views in which boxes at random positions hide a quarter of it."""
    floor_m = 0.8 + 0.001 * np.arange(W)[None] + np.zeros((H, 1))
    views = []
    for _ in range(count):
        depth_m = floor_m + sigma_m * rng.standard_normal(floor_m.shape)
        color = np.full((H, W, 3), 40, dtype=np.uint8)
        for _ in range(5):
            y, x = rng.integers(0, H - 15), rng.integers(0, W - 20)
            depth_m[y : y + 15, x : x + 20] = 0.8 - rng.uniform(0.02, 0.1)
            color[y : y + 15, x : x + 20] = 200
        depth_m[rng.random(depth_m.shape) < 0.01] += 0.05  # outliers behind the floor
        depth_m[rng.random(depth_m.shape) < 0.05] = np.nan
        views.append(BinView(name="v", camera=CAMERA, depth_m=depth_m, rgb=color))
    return floor_m, views


def test_a_composite_of_five_views_shows_the_floor_without_parts_and_outliers():
    floor_m, views = cluttered(5, np.random.default_rng(1))
    empty = empty_view(views)
    known = ~np.isnan(empty.depth_m)
    off = np.abs(empty.depth_m - floor_m)[known]
    assert known.mean() > 0.95
    assert (off < 1e-3).mean() > 0.98  # Parts at the same place in two views may remain.
    assert (empty.rgb[known] == 40).all(axis=-1).mean() > 0.95


def test_the_composite_uses_the_farthest_pair_of_agreeing_depths():
    depth_m = np.array([0.9, 0.7, 0.7004, 0.5, 0.5001]).reshape(5, 1, 1)
    assert farthest_shared(depth_m).item() == pytest.approx(0.7002)
    assert np.isnan(farthest_shared(depth_m[:2]).item())
    assert np.isnan(farthest_shared(np.full((3, 1, 1), np.nan)).item())


def test_a_single_view_has_no_composite():
    _, views = cluttered(1, np.random.default_rng(2))
    with pytest.raises(DatasetError, match="give at least two views"):
        empty_view(views)
