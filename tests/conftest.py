"""What tests share: the render device of the process, and the data beside the repository."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def cpu_device():
    """Mitsuba on the processor, opened once: a process cannot change its device."""
    from graycast.render.device import open_device

    open_device("llvm")


@pytest.fixture(scope="session")
def mitsuba_renderer(cpu_device):
    from graycast.render import open_renderer

    return open_renderer("mitsuba")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of test data beside the repository; tests that need it skip where it is not."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("needs ../shared/data beside the repository, which is not here")
    return folder.parent
