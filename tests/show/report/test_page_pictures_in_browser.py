"""Scenes of several pictures on the page: switching between them, and their fusion in 3D."""

import json

import numpy as np
import pytest
from several_pictures import NAMES, several  # noqa: F401

from graycast.show.report.page import write_report

from .browsing import pressed, ready, watched_page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page_of_several(several, tmp_path_factory):  # noqa: F811
    return write_report(several[0], tmp_path_factory.mktemp("several") / "page").page


@pytest.fixture
def page(browser, page_of_several):
    with watched_page(browser, page_of_several.as_uri()) as page:
        yield page


def opened(page, address, key):
    page.goto(f"{address}#/{key}")
    ready(page, key)


def depth_on_page(page):
    values = page.evaluate(
        "(() => { const s = Graycast.opened().scene;"
        " return [s.width, s.height, Array.from(s.scanner), s.depth_scale_mm]; })()"
    )
    width, height, steps, scale_mm = values
    return np.array(steps).reshape(height, width) * scale_mm / 1000


def test_each_picture_has_a_card_that_the_search_finds_by_name(page):
    assert page.locator(".card").count() == 2 * len(NAMES)
    page.fill("#find", "right-1")
    page.wait_for_function("document.querySelectorAll('.card').length === 2")
    assert "right-1" in page.locator(".card b").first.inner_text()


def test_a_switch_shows_the_scene_s_other_pictures(page, page_of_several, several):  # noqa: F811
    """Oracle: the depth of each scanner; the active view stays the same."""
    address, taken = page_of_several.as_uri(), several[1]
    opened(page, address, "train-000003-left-0")
    page.click('[data-view="scanner"]')
    assert page.locator("#choose-picture option").all_inner_texts() == list(NAMES)
    for place in (2, 1, 3):
        page.select_option("#choose-picture", f"train-000003-{NAMES[place]}")
        ready(page, f"train-000003-{NAMES[place]}")
        depth_m = np.nan_to_num(taken[3][place].scanner_depth.depth_m)
        assert depth_on_page(page) == pytest.approx(depth_m, abs=2e-5)
        assert pressed(page) == "scanner"
    page.keyboard.press("n")  # After the last picture comes the first.
    ready(page, "train-000003-left-0")


def test_the_fused_cloud_is_on_the_parts_in_3d(page, page_of_several, several):  # noqa: F811
    """Oracle: the points that the pictures measured, from their own cameras."""
    opened(page, page_of_several.as_uri(), "train-000000-right-0")
    page.click('[data-view="cloud"]')
    before = page.screenshot(clip={"x": 50, "y": 150, "width": 800, "height": 500})
    page.click("#toggle-fused")
    page.wait_for_function("document.querySelector('.under').innerText.includes('of 4 pictures')")
    cloud = page.evaluate(
        "(() => { const c = Graycast.opened().scene.fusing.cloud;"
        " return [c.low, c.step, ...[c.place, c.view, c.first].map((a) => Array.from(a))]; })()"
    )
    low, step, place, view, first = cloud
    point_m = (np.array(low) + step * np.array(place).reshape(-1, 3)) / 1000
    assert set(view) == {0, 1, 2, 3} and 3 in first  # 3 is the hole in the first picture.
    assert len(point_m) > 19000 and point_m[:, 2].min() > -2e-3 and point_m[:, 2].max() < 0.1
    after = page.screenshot(clip={"x": 50, "y": 150, "width": 800, "height": 500})
    assert before != after
    for paint in ("views", "view", "sigma", "first"):
        page.select_option("#choose-fusedPaint", paint)
        assert page.locator(".under").inner_text()
    page.keyboard.press("f")
    assert page.get_attribute("#toggle-fused", "aria-pressed") == "false"


def test_a_selection_saved_on_the_page_lists_the_pictures(page_of_several):
    index = (page_of_several.parent / "index.js").read_text()
    content = json.loads(index.removeprefix("Graycast.report = ").removesuffix(";\n"))
    rows = [dict(zip(content["columns"], row, strict=True)) for row in content["scenes"]]
    assert [row["picture"] for row in rows] == list(NAMES) * 2
    assert set(content["scanners"]) == {"left", "right"}
    fused = sorted(path.parent.name for path in page_of_several.parent.glob("scenes/*/fused.js"))
    assert fused == ["train-000000-left-0", "train-000003-left-0"]
