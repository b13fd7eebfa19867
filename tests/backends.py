"""Which back ends a contract test meets: Cycles in the slow suite, as its renders take time."""

import pytest

REFERENCE, MITSUBA = "reference", "mitsuba"
CYCLES = pytest.param("cycles", marks=pytest.mark.slow)
