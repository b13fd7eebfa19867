"""Small pages, and a browser that opens them from the disk."""

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
    """Build the same page with captured frames and decoded columns."""
    folder = tmp_path_factory.mktemp("kept")
    samples = write_dataset(folder / "bins", scene_ids=(0, 3), rig=rig, keeps=True)
    return folder / "bins", samples, write_report(folder / "bins", folder / "page").page


@pytest.fixture
def page(browser, report):
    """Open the overview; at the end, any message of the browser fails the test."""
    with watched_page(browser, report[2].as_uri()) as page:
        yield page
