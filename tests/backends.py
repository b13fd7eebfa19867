"""Which back ends a contract test meets: Cycles in the slow suite, as its renders take time."""

import pytest

REFERENCE, MITSUBA = "reference", "mitsuba"


def slow(*values):
    """A case that the slow suite alone meets."""
    return pytest.param(*values, marks=pytest.mark.slow)


CYCLES = slow("cycles")
