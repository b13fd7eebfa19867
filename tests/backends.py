"""Which back ends a contract test meets: Cycles in the slow suite, as its renders take time."""

import pytest

from graycast.rendering import Quality

REFERENCE, MITSUBA = "reference", "mitsuba"


def slow(*values):
    """A case that the slow suite alone meets."""
    return pytest.param(*values, marks=pytest.mark.slow)


CYCLES = slow("cycles")


def direct_light(renderer):
    """Each sample of the exact renderer costs the same as a picture: it takes a 4 x 4 grid."""
    return Quality(samples=16 if renderer.name == REFERENCE else 64, depth=1)
