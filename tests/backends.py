"""Which back ends a contract test meets, and how fast.

A test runs on Cycles in the slow suite alone, as each of its renders takes a moment, unless it is
marked with one of these.
"""

import pytest

REFERENCE, MITSUBA, CYCLES = "reference", "mitsuba", "cycles"

quick_on_all = pytest.mark.parametrize("renderer", [REFERENCE, MITSUBA, CYCLES], indirect=True)
quick_on_path_tracers = pytest.mark.parametrize("path_tracer", [MITSUBA, CYCLES], indirect=True)
