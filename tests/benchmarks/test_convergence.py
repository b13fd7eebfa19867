"""The number of samples for a given error, inside and outside the measured range."""

import pytest

from benchmarks.convergence import samples_for


def rows(law, counts=(4, 8, 16, 32)):
    return [{"samples": n, "error": law(n)} for n in counts]


@pytest.mark.parametrize("wanted", [5.0, 8.0, 25.0])
def test_a_power_law_is_read_back_exactly(wanted):
    def law(n):
        return 3 / n**0.7

    samples, side = samples_for(rows(law), "error", law(wanted))
    assert samples == pytest.approx(wanted) and side == ""


def test_an_error_outside_the_measured_range_is_marked_as_above_or_below():
    assert samples_for(rows(lambda n: 1 / n), "error", 0.01) == (32.0, ">")
    assert samples_for(rows(lambda n: 1 / n), "error", 0.5) == (4.0, "<")
    assert samples_for(rows(lambda n: 1 / n), "error", 0.25) == (4.0, "")


def test_the_first_crossing_counts_even_if_an_error_is_zero():
    errors = [{"samples": n, "error": e} for n, e in ((4, 1.0), (8, 0.0), (16, 0.5))]
    assert samples_for(errors, "error", 0.3) == (8.0, "")
