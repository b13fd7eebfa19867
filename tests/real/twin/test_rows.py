"""Statistics in closed form: noise that rows have in common, and counted holes."""

import numpy as np
import pytest

from graycast.real.realism.patches import find_floor
from graycast.real.twin.rows import ROWS, Figures, compare, figures_of

from ..realism.synthetic import plane, scan

SIGMA_M = 1e-4


def row(depth_m, name):
    return figures_of([scan(depth_m)], None).value[name][0]


def noisy(spread, seed=0):
    """Return a plane with normal noise, whose standard deviation may vary from square to square."""
    z_m = plane()
    return z_m + SIGMA_M * spread * np.random.default_rng(seed).standard_normal(z_m.shape)


@pytest.mark.parametrize("missing", [0.5, 0.99, 1.0])
def test_a_scan_without_smooth_squares_has_no_texture(missing):
    """A search also tries scanners that see almost nothing: their scans are no error."""
    z_m = noisy(1.0)
    z_m[np.random.default_rng(1).random(z_m.shape) < missing] = np.nan
    for name in ("noise along x above fine noise", "noise common to rows"):
        assert np.isnan(row(z_m, name))


def test_noise_common_to_a_row_is_reported_as_correlation():
    """Rows are a sum of their own noise and of that of neighbours: the correlation of `a_y + k
    a_(y+1)` with the next row is `k / (1 + k^2)`, which columns do not have.
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
    z_m[40:200:20, 40:200:20] = np.nan  # These holes are isolated.
    z_m[220:224, 100:140] = np.nan  # a wide hole
    single = 8 * 8
    # Not counted are inner pixels that lack a neighbour: those next to a hole, in the wide hole,
    # and in the rows and columns that touch it.
    places = 238 * 318 - 4 * single - 4 * 40 - 2 * 40 - 2 * 4
    percent = row(z_m, "missing among present neighbours")
    assert percent == pytest.approx(100 * single / places, rel=1e-9)
    assert row(z_m, "holes of 1 px") == single and row(z_m, "holes of 2 to 4 px") == 0


@pytest.mark.slow
def test_only_holes_in_the_plane_of_the_floor_count_as_holes_of_the_floor():
    """The plane is at 0.6 m; a box on it, half of the picture, has other holes."""
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
    """Otherwise, scans that are equal by chance would match no statistics."""
    real = Figures(value={name: np.full(3, 1.0) for name in ROWS})
    spread = {one.name: one.spread for one in compare(real, real)}
    assert spread["fine noise, median"] == 0.05
    assert spread["noise along x above fine noise"] == 2.0
    assert spread["missing where a real scan has depth"] == 3.0
