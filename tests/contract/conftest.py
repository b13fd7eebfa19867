"""Every test in this folder runs on every back end."""

import pytest

from graycast.render import open_renderer


@pytest.fixture(params=["reference", "mitsuba"], scope="session")
def renderer(request):
    if request.param == "mitsuba":
        request.getfixturevalue("cpu_device")
    return open_renderer(request.param)
