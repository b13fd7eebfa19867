"""Back ends for contract tests; Cycles is slow, so it is only in the slow suite."""

import pytest

from graycast.rendering import Quality

REFERENCE, MITSUBA = "reference", "mitsuba"


def slow(*values):
    """Return a test case that runs only in the slow suite."""
    return pytest.param(*values, marks=pytest.mark.slow)


CYCLES = slow("cycles")


def direct_light(renderer):
    """Return the quality for direct light; the exact renderer needs 16 samples (a 4 x 4 grid)."""
    return Quality(samples=16 if renderer.name == REFERENCE else 64, depth=1)
