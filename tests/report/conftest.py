"""Small pages, and a browser to open them from the disk."""

import shutil

import pytest
from pictured import lensed_rig, write_dataset

from graycast.report.page import write_report

from .browsing import SCENES, ready

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def rig():
    return lensed_rig()


@pytest.fixture(scope="session")
def made(rig, tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    samples = write_dataset(folder / "bins", scene_ids=SCENES, rig=rig)
    return folder / "bins", samples, write_report(folder / "bins", folder / "page").page


@pytest.fixture(scope="session")
def kept(rig, tmp_path_factory):
    """The same with captured frames and decoded columns."""
    folder = tmp_path_factory.mktemp("kept")
    samples = write_dataset(folder / "bins", scene_ids=(0, 3), rig=rig, keeps=True)
    return folder / "bins", samples, write_report(folder / "bins", folder / "page").page


@pytest.fixture(scope="session")
def browser():
    """Chromium of the system; nothing is downloaded."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright: pip install 'graycast[test]'"
    )
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("needs chromium: apt-get install chromium")
    with playwright.sync_playwright() as running:
        yield running.chromium.launch(executable_path=path, args=FLAGS)


@pytest.fixture
def page(browser, made):
    """The overview; at the end, whatever the browser complained about fails the test."""
    complaints = []
    page = browser.new_page(viewport={"width": 1400, "height": 860})
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "request",
        lambda request: (
            request.url.startswith(("file:", "data:", "blob:")) or complaints.append(request.url)
        ),
    )
    page.goto(made[2].as_uri())
    ready(page, "overview")
    yield page
    page.close()
    assert complaints == []
