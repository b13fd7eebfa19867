"""Back ends for contract tests; Cycles is only in the slow suite, because it is slow."""

import pytest

from graycast.rendering import Quality

REFERENCE, MITSUBA = "reference", "mitsuba"


def slow(*values):
    """Return a test case that runs only in the slow suite."""
    return pytest.param(*values, marks=pytest.mark.slow)


CYCLES = slow("cycles")


def direct_light(renderer):
    """Return the quality for direct light; 16 samples (a 4 x 4 grid) for the exact renderer."""
    return Quality(samples=16 if renderer.name == REFERENCE else 64, depth=1)
