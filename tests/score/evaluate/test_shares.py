"""Shares against published examples and against the binomial distribution."""

import pytest

from graycast.score.evaluate import mcnemar, wilson


def test_wilsons_interval_agrees_with_published_examples():
    """Oracle: binom.confint(..., methods = "wilson") of R for (9, 10) and (0, 20)."""
    assert wilson(9, 10) == pytest.approx((0.59585, 0.98212), abs=1e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.16113), abs=1e-5)


def test_mcnemars_p_value_agrees_with_the_binomial_distribution():
    """Counts of 1 and 9 give p = 2 (1 + 10) / 2^10; equal counts give p = 1."""
    assert mcnemar(1, 9) == pytest.approx(2 * 11 / 1024)
    assert mcnemar(9, 1) == mcnemar(1, 9)
    assert mcnemar(5, 5) == mcnemar(0, 0) == 1.0


def test_the_interval_for_a_share_of_0_or_1_ends_at_that_share():
    """(p + z^2/2n +- ...) / (1 + z^2/n) is exactly 1 or 0 there, except for rounding errors."""
    for of in range(1, 300):
        assert wilson(of, of)[1] == 1.0 and wilson(0, of)[0] == 0.0
