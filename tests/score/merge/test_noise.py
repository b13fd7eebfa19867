"""Sigma of a stored view, against the simulated noise and the law of triangulation."""

from dataclasses import replace

import numpy as np
import pytest
from seen import FINE

from graycast.rig.pair import preset_rig
from graycast.score.merge.stored_views import depth_slope_m, measured_noise_px


def rig():
    paper = preset_rig("paper")
    return replace(paper, camera=FINE)


@pytest.mark.slow
def test_the_slope_of_parallel_lenses_is_depth_squared_over_focal_length_and_baseline():
    """Oracle: u = f (x - b / z), where x depends only on the pixel, so |dz/du| = z^2 / (f b)."""
    T = np.eye(4)
    T[0, 3] = 0.2
    parallel = replace(rig(), T_cam_proj=T)
    f_px = parallel.projector.fx_px
    assert not parallel.projector.has_distortion
    slope_m = depth_slope_m(np.full((240, 320), 0.8), parallel)
    assert slope_m == pytest.approx(0.8**2 / (f_px * 0.2), rel=1e-6)


@pytest.mark.parametrize("noise_px", [0.05, 0.2])
def test_measured_noise_agrees_with_the_true_noise_at_every_brightness(noise_px):
    """Noise that decreases with light, on a slanted plane, is estimated to 5 %."""
    rng, scanner = np.random.default_rng(1), rig()
    row, column = np.mgrid[:240, :320]
    true_m = 0.9 / (1 + 0.2 * (column - 160) / 400 + 0.1 * (row - 120) / 400)
    light = 1000 + 100 * row
    sigma_px = noise_px * 10000 / light
    slope_m = depth_slope_m(true_m, scanner)
    depth_m = true_m + slope_m * sigma_px * rng.standard_normal(true_m.shape)
    estimate_px = measured_noise_px(depth_m, slope_m, light, scanner)
    middle = np.s_[40:200, 5:-5]  # Outside the extreme groups, the estimate is constant.
    ratio = estimate_px[middle] / sigma_px[middle]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)
    assert 0.8 < ratio.min() and ratio.max() < 1.2
