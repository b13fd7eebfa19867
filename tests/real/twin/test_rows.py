"""Statistics of scans, compared with closed forms: correlated noise, and counts of holes."""

import numpy as np
import pytest

from graycast.real.realism.patches import find_floor
from graycast.real.twin.rows import ROWS, Figures, compare, figures_of

from ..realism.synthetic import plane, scan

SIGMA_M = 1e-4


def row(depth_m, name):
    return figures_of([scan(depth_m)], None).value[name][0]


def noisy(spread, seed=0):
    """Return a plane with normal noise of standard deviation `SIGMA_M` times `spread`."""
    z_m = plane()
    return z_m + SIGMA_M * spread * np.random.default_rng(seed).standard_normal(z_m.shape)


@pytest.mark.parametrize("missing", [0.5, 0.99, 1.0])
def test_a_scan_without_smooth_squares_has_no_texture(missing):
    """A search also tries scanners that measure almost nothing, so this is not an error."""
    z_m = noisy(1.0)
    z_m[np.random.default_rng(1).random(z_m.shape) < missing] = np.nan
    for name in ("noise along x above fine noise", "noise common to rows"):
        assert np.isnan(row(z_m, name))


def test_noise_common_to_a_row_is_reported_as_correlation():
    """A row is the sum of its own noise and k times that of the next row, `a_y + k a_(y+1)`. Its
    correlation with the next row is `k / (1 + k^2)`; columns are not correlated.
    """
    k, white = (
        0.3,
        np.random.default_rng(2).standard_normal((plane().shape[0] + 1, plane().shape[1])),
    )
    z_m = plane() + SIGMA_M * (white[:-1] + k * white[1:])
    assert row(z_m, "noise common to rows") == pytest.approx(k / (1 + k * k), abs=0.03)
    assert row(z_m, "noise common to columns") == pytest.approx(0, abs=0.03)


def test_only_isolated_holes_are_counted():
    z_m = plane().copy()
    z_m[40:200:20, 40:200:20] = np.nan  # isolated holes
    z_m[220:224, 100:140] = np.nan  # a wide hole
    single = 8 * 8
    # Inner pixels count only if all four neighbours have depth, unlike the neighbours of a hole,
    # the pixels in the wide hole, and the rows and columns that touch it.
    places = 238 * 318 - 4 * single - 4 * 40 - 2 * 40 - 2 * 4
    percent = row(z_m, "missing among present neighbours")
    assert percent == pytest.approx(100 * single / places, rel=1e-9)
    assert row(z_m, "holes of 1 px") == single and row(z_m, "holes of 2 to 4 px") == 0


@pytest.mark.slow
def test_only_holes_in_the_plane_of_the_floor_count_as_holes_of_the_floor():
    """The other half of the picture is a box on the floor, with other holes."""
    z_m = plane().copy()
    z_m[:, 160:] -= 0.02
    z_m[40:200:20, 40:140:20] = np.nan
    z_m[40:200:10, 200:300:10] = np.nan
    floor = find_floor([plane()])
    figures = figures_of([scan(z_m)], floor).value
    on_floor = 238 * 158 - 4 * 8 * 5
    assert figures["holes in the floor"][0] == pytest.approx(100 * 40 / on_floor, rel=0.01)


def test_missing_depth_is_counted_for_each_side_of_the_bin():
    z_m = plane().copy()
    side, visible = np.zeros(z_m.shape, dtype=bool), np.ones(z_m.shape, dtype=bool)
    side[:, :50], visible[:120] = True, False
    z_m[60:150, :50] = np.nan
    figures = figures_of([scan(z_m)], None, {"left": side, "visible": visible}).value
    assert figures["missing on the bin's left side"][0] == pytest.approx(100 * 90 / 240)
    assert figures["missing where a real scan has depth"][0] == pytest.approx(100 * 30 * 50 / 38400)
    assert np.isnan(figures["missing on the bin's upper side"][0])


def test_equal_scans_have_the_smallest_allowed_spread():
    """Otherwise, a twin could not match scans that are equal by chance."""
    real = Figures(value={name: np.full(3, 1.0) for name in ROWS})
    spread = {one.name: one.spread for one in compare(real, real)}
    assert spread["fine noise, median"] == 0.05
    assert spread["noise along x above fine noise"] == 2.0
    assert spread["missing where a real scan has depth"] == 3.0
