"""Statistics by closed forms: a normal law has no tails, a mixture its own; holes are counted."""

from math import sqrt

import numpy as np
import pytest
from scipy.stats import norm

from graycast.real.twin.rows import ROWS, Figures, _from_place_to_place, compare, figures_of

from ..realism.synthetic import plane, scan

SIGMA_M = 1e-4


def row(depth_m, name):
    return figures_of([scan(depth_m)], None).value[name][0]


def noisy(spread, seed=0):
    """A plane with normal noise whose standard deviation varies from square to square, or not."""
    z_m = plane()
    return z_m + SIGMA_M * spread * np.random.default_rng(seed).standard_normal(z_m.shape)


def test_normal_noise_has_no_tails():
    assert row(noisy(1.0), "tails of the noise") == pytest.approx(0, abs=1.5)
    assert row(noisy(1.0), "differences far out") < 0.1


def test_noise_that_varies_within_a_square_has_the_tails_of_its_mixture():
    """Left half of each square of 32 px is three times as noisy: the median of a mixture of two
    normal laws by bisection, its standard deviation by sums.
    """
    z_m = plane()
    spread = np.where(np.arange(z_m.shape[1]) % 32 < 16, 3.0, 1.0)
    low, high = 0.0, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        share = np.mean([2 * norm.cdf(middle / s) - 1 for s in (1, 3)])
        low, high = (middle, high) if share < 0.5 else (low, middle)
    limit = 4 * 1.4826 * low

    def cut(s):  # second moment of a normal law within the limit, and its probability
        a = limit / s
        inside = 2 * norm.cdf(a) - 1
        return s * s * (inside - 2 * a * norm.pdf(a)), inside

    parts = [cut(s) for s in (1.0, 3.0)]
    core = sqrt(sum(p[0] for p in parts) / sum(p[1] for p in parts))
    expected = 100 * (core / (1.4826 * low) - 1)
    found = row(noisy(spread[None]), "tails of the noise")
    assert found == pytest.approx(expected, rel=0.2)  # differences reach over the borders


@pytest.mark.parametrize("missing", [0.5, 0.99, 1.0])
def test_a_scan_without_smooth_squares_has_no_texture(missing):
    """A search tries scanners that see next to nothing: their scans are no error."""
    z_m = noisy(1.0)
    z_m[np.random.default_rng(1).random(z_m.shape) < missing] = np.nan
    for name in ("noise along x above fine noise", "noise common to rows"):
        assert np.isnan(row(z_m, name))


def test_noise_differs_from_place_to_place_by_the_law_of_its_amplitude():
    """Amplitudes of squares of 16 px, normal in their logarithm, come back as its spread; what each
    square tells by chance adds to it in quadrature, and is all that even noise has.
    """
    rng = np.random.default_rng(4)
    spread, even = 0.3, rng.standard_normal((480, 640))
    amplitude = np.kron(np.exp(spread * rng.standard_normal((30, 40))), np.ones((16, 16)))
    chance = _from_place_to_place(SIGMA_M * even)
    # The median of 256 sizes: a standard error of 1 / (2 f sqrt(256)), f the density there.
    size = norm.ppf(0.75)
    assert chance == pytest.approx(100 / (2 * 2 * norm.pdf(size) * 16) / size, rel=0.1)
    told = _from_place_to_place(SIGMA_M * amplitude * even)
    assert told == pytest.approx(sqrt((100 * spread) ** 2 + chance**2), rel=0.07)


def test_noise_common_to_rows_is_that_of_the_squares():
    """Rows that are a sum of their own noise and of what neighbours have: the correlation of
    `a_y + k a_(y+1)` with the next row is `k / (1 + k^2)`, which columns do not have.
    """
    k, white = (
        0.3,
        np.random.default_rng(2).standard_normal((plane().shape[0] + 1, plane().shape[1])),
    )
    z_m = plane() + SIGMA_M * (white[:-1] + k * white[1:])
    assert row(z_m, "noise common to rows") == pytest.approx(k / (1 + k * k), abs=0.03)
    assert row(z_m, "noise common to columns") == pytest.approx(0, abs=0.03)
    assert row(z_m, "noise common to rows 2 px apart") == pytest.approx(0, abs=0.03)


def test_single_holes_in_flat_places_are_counted_and_others_are_not():
    z_m = plane().copy()
    z_m[40:200:20, 40:200:20] = np.nan  # alone in a plane
    z_m[220:224, 100:140] = np.nan  # a wide one
    single = 8 * 8
    places = 238 * 318 - 8 * single - 6 * 42  # that have eight neighbours with depth
    assert row(z_m, "holes in flat places") == pytest.approx(1e4 * single / places, rel=1e-9)


@pytest.mark.parametrize("apart", [1, 2])
def test_noise_common_to_rows_is_told_at_its_distance_alone(apart):
    """A moving sum of two rows of independent noise has the correlation 1/2 at their distance."""
    z_m = plane()
    rng = np.random.default_rng(1)
    white = rng.standard_normal((z_m.shape[0] + apart, z_m.shape[1]))
    depth_m = z_m + SIGMA_M * (white[apart:] + white[:-apart]) / sqrt(2)
    told = [row(depth_m, f"noise common to rows{where}") for where in ("", " 2 px apart")]
    assert told[apart - 1] == pytest.approx(0.5, abs=0.03)
    assert told[2 - apart] == pytest.approx(0.0, abs=0.03)
    assert row(depth_m, "noise common to columns") == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("turned", [False, True])
def test_noise_of_slopes_is_told_by_the_way_that_they_slope(turned):
    """White noise along the slope that neighbours across it share half of, on one slope only."""
    z_m = plane(tilt_rad=1.0, distance_m=0.6)
    rng = np.random.default_rng(2)
    white = rng.standard_normal((z_m.shape[0] + 1, z_m.shape[1]))
    depth_m = z_m + SIGMA_M * (white[1:] + white[:-1]) / sqrt(2)
    if turned:
        depth_m = depth_m.T[: z_m.shape[0]]
    rows, columns = (
        row(depth_m, f"noise common to {lines}, sloping along {axis}")
        for lines, axis in (("rows", "x"), ("columns", "y"))
    )
    shared, other = (columns, rows) if turned else (rows, columns)
    assert shared == pytest.approx(0.5, abs=0.03)
    assert np.isnan(other)


def test_a_facing_surface_tells_nothing_of_slopes():
    assert np.isnan(row(noisy(1.0), "noise along x above fine noise, sloping along x"))


def test_holes_that_stand_together_leave_more_squares_whole():
    """Of 7 x 10 squares of 32 px, one has the 49 holes, or each of 49 has one."""
    together, strewn = plane().copy(), plane().copy()
    together[40:47, 40:47] = np.nan
    strewn[16:224:32, 16:224:32] = np.nan
    for depth_m, whole in ((together, 69), (strewn, 21)):
        assert row(depth_m, "smooth squares without a hole") == pytest.approx(100 * whole / 70)
    bent = strewn + 0.01 * np.sin(np.arange(320) * 0.8)
    bent[:, 256:] = strewn[:, 256:]  # the squares that have holes are no longer smooth
    assert row(bent, "smooth squares without a hole") == pytest.approx(100)


def test_depth_that_is_missing_on_a_side_of_the_bin_is_counted_there():
    z_m = plane().copy()
    side, seen = np.zeros(z_m.shape, dtype=bool), np.ones(z_m.shape, dtype=bool)
    side[:, :50], seen[:120] = True, False
    z_m[60:150, :50] = np.nan
    told = figures_of([scan(z_m)], None, {"left": side, "seen": seen}).value
    assert told["missing on the bin's left side"][0] == pytest.approx(100 * 90 / 240)
    assert told["missing where a real scan has depth"][0] == pytest.approx(100 * 30 * 50 / 38400)
    assert np.isnan(told["missing on the bin's upper side"][0])


def test_three_equal_scans_are_believed_to_a_twentieth_or_to_the_declared_spread():
    """Scans that happen to be equal would else meet no row at all."""
    real = Figures(value={name: np.full(3, 1.0) for name in ROWS})
    spread = {one.name: one.spread for one in compare(real, real)}
    assert spread["fine noise, median"] == 0.05
    assert spread["noise along x above fine noise"] == 2.0
    assert spread["missing where a real scan has depth"] == 3.0
