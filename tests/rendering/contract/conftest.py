"""Every test in this folder runs on each renderer that supports the subject of the test."""

import pytest
from backends import CYCLES, MITSUBA, REFERENCE

from graycast.rendering import open_renderer


@pytest.fixture(params=[REFERENCE, MITSUBA, CYCLES], scope="session")
def renderer(request):
    """All renderers: surfaces, sharp lenses and direct light of the projector."""
    if request.param == REFERENCE:
        return open_renderer(REFERENCE)
    return request.getfixturevalue(f"{request.param}_renderer")


@pytest.fixture(params=[MITSUBA, CYCLES], scope="session")
def path_tracer(request):
    """Renderers that also have parts, lamps, interreflection and blur."""
    return request.getfixturevalue(f"{request.param}_renderer")
