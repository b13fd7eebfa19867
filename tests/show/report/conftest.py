"""Small pages, and a browser to open them from the disk."""

import pytest
from pictured import lensed_rig, write_dataset

from graycast.show.report.page import write_report

from .browsing import SCENES, watched_page


@pytest.fixture(scope="session")
def rig():
    return lensed_rig()


@pytest.fixture(scope="session")
def report(rig, tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    samples = write_dataset(folder / "bins", scene_ids=SCENES, rig=rig)
    return folder / "bins", samples, write_report(folder / "bins", folder / "page").page


@pytest.fixture(scope="session")
def report_with_frames(rig, tmp_path_factory):
    """The same with captured frames and decoded columns."""
    folder = tmp_path_factory.mktemp("kept")
    samples = write_dataset(folder / "bins", scene_ids=(0, 3), rig=rig, keeps=True)
    return folder / "bins", samples, write_report(folder / "bins", folder / "page").page


@pytest.fixture
def page(browser, report):
    """The overview; at the end, whatever the browser complained about fails the test."""
    with watched_page(browser, report[2].as_uri()) as page:
        yield page
