"""Searching, selecting, tagging, saving and comparing scenes on the page, as a user does it."""

import json

import cv2
import numpy as np
import pytest
from pictured import write_dataset

from graycast.cli import main
from graycast.dataset.export.formats import selected_pictures
from graycast.dataset.read.stored import open_dataset
from graycast.show.report.page import write_report

from .browsing import canvas_pixels, opened, place, pressed, readout, ready, scene_map

pytestmark = [
    pytest.mark.slow,
    # An array type of pycocotools 2.0.11 is older than NumPy 2, which warns about it.
    pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning"),
]

TIMES = "\N{MULTIPLICATION SIGN}"
SIZES = [(1400, 900), (1024, 768), (1920, 1080)]


@pytest.fixture
def page(page):
    """Open the overview without the tags of the previous test."""
    page.evaluate("localStorage.clear()")
    page.reload()
    ready(page, "overview")
    return page


def cards(page):
    return page.eval_on_selector_all(".card", "all => all.map((card) => card.dataset.key)")


def focused(page):
    return page.evaluate("document.activeElement.closest('.card')?.dataset.key")


def tag(page, text):
    """Tag the selected scenes, or the open scene, with the keyboard."""
    page.keyboard.press("g")
    page.keyboard.type(text)
    page.keyboard.press("Enter")


# --- all scenes -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "scene_ids"),
    [
        ("3", [3]),
        ("3-9", [3, 4]),
        ("WEDGE", [0, 3, 4]),
        ("wedge 4", [4]),
        ("train-000000", [0]),
        ("gear", []),
    ],
)
def test_a_search_finds_scenes_by_number_range_and_part(page, text, scene_ids):
    page.keyboard.press("/")
    page.keyboard.type(text)
    page.wait_for_function(f"document.querySelectorAll('.card').length === {len(scene_ids)}")
    assert cards(page) == [f"train-{k:06d}" for k in scene_ids]
    assert f"{len(scene_ids)} of 3 scenes" in page.locator("#told").inner_text()
    if not scene_ids:
        assert "No scene matches" in page.locator(".nothing").inner_text()
        page.click("#lift-all")
        assert len(cards(page)) == 3 and page.input_value("#find") == ""


def test_an_active_filter_is_shown_with_a_button_that_removes_the_filter(page):
    page.click("#more summary")
    page.fill("#decoded-from", "99.9")
    assert page.locator("#more summary").inner_text().startswith("filters (1)")
    chip = page.locator(".told-row .chip")
    assert chip.inner_text().startswith("decoded 99.9 to 100 %") and not cards(page)
    chip.locator("button").click()
    assert len(cards(page)) == 3 and chip.count() == 0


def test_cards_can_be_selected_and_opened_by_keys(page):
    page.keyboard.press("ArrowRight")
    assert focused(page) == "train-000000"
    page.keyboard.press("ArrowRight")
    assert focused(page) == "train-000003"
    page.keyboard.press("End")
    assert focused(page) == "train-000004"
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    ready(page, "train-000003")
    page.keyboard.press("ArrowRight")
    ready(page, "train-000004")
    page.keyboard.press("Escape")
    ready(page, "overview")
    assert focused(page) == "train-000004"  # The selection continues from the last scene.


def test_tags_of_selected_scenes_are_kept_and_can_be_searched(page):
    page.keyboard.press("ArrowRight")
    page.keyboard.press("x")
    page.keyboard.press("End")
    page.keyboard.press("Shift+X")
    assert page.locator("#ticked b").inner_text() == "3 ticked"
    page.hover('.card[data-key="train-000003"]')
    page.click('.card[data-key="train-000003"] .tick-box')
    tag(page, "dark spots,  odd")
    assert page.locator('.card[data-key="train-000004"] .chip').all_inner_texts() == [
        "dark spots",
        "odd",
    ]
    page.keyboard.press("Escape")
    assert page.locator("#ticked").is_hidden()
    page.reload()  # Tags must survive a reload.
    ready(page, "overview")
    page.select_option("#pick-tag", "=odd")
    assert cards(page) == ["train-000000", "train-000004"]
    page.select_option("#pick-tag", "!odd")
    assert cards(page) == ["train-000003"]
    page.click("#reset")
    page.fill("#find", "spots")
    assert cards(page) == ["train-000000", "train-000004"]
    page.click("#reset")
    opened_card = page.locator('.card[data-key="train-000004"] a')
    opened_card.click()
    ready(page, "train-000004")
    page.click('#tags [data-tag="odd"] button')
    tag(page, "good")
    assert page.locator("#tags .chip").evaluate_all("all => all.map((c) => c.dataset.tag)") == [
        "dark spots",
        "good",
    ]
    page.keyboard.press("Escape")
    ready(page, "overview")
    page.select_option("#pick-tag", "=odd")
    assert cards(page) == ["train-000000"]


def test_export_and_page_read_a_saved_selection(page, report, tmp_path):
    dataset = report[0]
    page.keyboard.press("End")
    page.keyboard.press("x")
    tag(page, "odd")
    assert page.locator("#save").inner_text() == "save 1 ticked"
    with page.expect_download() as download:
        page.click("#save")
    saved = tmp_path / download.value.suggested_filename
    download.value.save_as(saved)
    assert saved.name == "bins-scenes.json"
    assert selected_pictures(saved, open_dataset(dataset)) == [4]
    command = ["dataset", "export", str(dataset), "--format", "yolo", "--selection", str(saved)]
    assert main([*command, "--out", str(tmp_path / "yolo")]) == 0
    assert [p.stem for p in (tmp_path / "yolo/images/train").iterdir()] == ["000004"]

    page.evaluate("localStorage.clear()")  # This simulates another browser.
    page.reload()
    ready(page, "overview")
    assert page.locator("#save").inner_text() == "save 3 shown"
    page.set_input_files("#load-file", saved)
    page.wait_for_selector('.card[data-key="train-000004"] .chip:has-text("odd")')
    message = page.locator("#message").inner_text()
    assert message == "Ticked, with the tags of bins-scenes.json: 1."
    assert page.locator("#ticked b").inner_text() == "1 ticked"


def test_a_selection_of_another_dataset_is_refused(page, tmp_path):
    for content, says in (
        ("no", "is not a file of scenes"),
        (
            json.dumps(
                {
                    "kind": "graycast-scenes",
                    "dataset": "pens",
                    "fingerprint": "0",
                    "scenes": {"train-000003": ["odd"]},
                }
            ),
            "belongs to another dataset (pens)",
        ),
    ):
        (tmp_path / "f.json").write_text(content)
        page.set_input_files("#load-file", tmp_path / "f.json")
        page.wait_for_selector(f'#message:has-text("{says}")')
        assert "Nothing was loaded" in page.locator("#message").inner_text()
        assert page.locator(".card .chip").count() == 0


def test_tags_of_another_dataset_are_not_shown(page, report, tmp_path):
    write_dataset(tmp_path / "bins", scene_ids=(4,))  # a dataset of the same name with another rig
    page.keyboard.press("End")
    page.keyboard.press("x")
    tag(page, "odd")
    page.goto(write_report(tmp_path / "bins", tmp_path / "page").page.as_uri())
    ready(page, "overview")
    assert page.locator(".card .chip").count() == 0


def test_scenes_are_visible_in_a_low_window(page):
    page.set_viewport_size({"width": 1000, "height": 700})
    page.reload()
    ready(page, "overview")
    box = page.locator(".card").first.bounding_box()
    assert box["y"] + box["height"] <= 700
    page.click(".figures > summary")
    page.wait_for_selector(".plot svg")


def test_the_plot_of_errors_has_the_range_of_most_points(page):
    """A few wrong points are at 40 mm, and most errors are about 0.1 mm, which cover many bins."""
    page.evaluate(
        """() => {
            const high = (k) => 1000 * (21 - Math.abs(k - 20));
            const core = Array.from({ length: 41 }, (_, k) => [k - 20, high(k)]);
            const counts = Object.fromEntries([...core, [4000, 20000]]);
            Object.assign(Graycast.report.statistics, {
                error_step_mm: 0.01, error_counts: counts, part_error_counts: counts,
            });
            Graycast.showOverview(document.getElementById("main"));
        }"""
    )
    plot = page.locator(".plot", has_text="Scanner error")
    beyond = 100 * 20000 / (441000 + 20000)
    assert f"beyond the plot: {beyond:.1f} % of parts" in plot.inner_text()
    ticks = plot.locator("svg .tick").all_text_contents()
    ends = [float(text) for text in ticks if text.strip("-.0123456789") == ""]
    assert 0.1 <= max(ends) <= 0.4


def test_a_single_value_is_shown_as_text_and_not_as_a_plot(page):
    titles = page.locator(".plot figcaption b").all_inner_texts()
    assert "Instances per scene" not in titles and "Scanner error" in titles
    assert "instances per scene: 8" in page.locator("#constant").inner_text()
    page.click(".figures > summary")
    assert not page.locator(".plots").is_visible()
    page.wait_for_function("localStorage.getItem('graycast-figures-shut') === 'yes'")
    page.reload()
    ready(page, "overview")
    assert not page.locator(".plots").is_visible()  # The choice is remembered.
    page.click(".figures > summary")
    page.wait_for_selector(".plot svg")


def test_cards_have_the_full_names_of_scene_and_parts(page):
    text = page.locator('.card[data-key="train-000000"]').inner_text()
    assert text.startswith("scene 0") and f"4 {TIMES} box" in text and f"4 {TIMES} wedge" in text
    name = "bracket_left_with_flange_and_a_long_name_M8x25_rev_C"
    page.evaluate(f"Graycast.report.classes[1] = {name!r}")
    page.evaluate("Graycast.showOverview(document.getElementById('main'))")
    for part in page.locator(".card .part").all():
        assert part.evaluate("(e) => e.scrollWidth <= e.clientWidth")
    for card in page.locator(".card").all():
        assert card.evaluate("(e) => e.scrollHeight <= e.clientHeight + 1")
    assert f"4 {TIMES} {name}" in page.locator(".card .part").all_inner_texts()


# --- one scene ------------------------------------------------------------------------------------


def test_two_views_are_compared_by_a_slider(page, report):
    opened(page, report, 0, "color")
    page.keyboard.press("Shift+Digit8")
    assert page.locator("#choose-second").input_value() == "reasons"
    box = page.locator(".stage").bounding_box()
    middle = box["y"] + box["height"] / 2
    share = "Number(document.getElementById('swipe').ariaValueNow)"
    page.mouse.move(box["x"] + 0.5 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.25 * box["width"], middle, steps=4)
    page.mouse.up()
    assert abs(page.evaluate(share) - 25) <= 1
    page.locator("#swipe").focus()
    page.keyboard.press("ArrowRight")
    assert abs(page.evaluate(share) - 27) <= 1
    ready(page, "train-000000")  # An arrow key on the slider does not open the next scene.
    first, second = canvas_pixels(page)[..., :3], canvas_pixels(page, "picture-2")[..., :3]
    pixels_of = on_screen(page)
    for column, expected in ((10, first), (30, first), (60, second), (150, second)):
        np.testing.assert_array_equal(pixels_of(column), expected[20:110:10, column])
    page.select_option("#choose-second", "color")  # This exchanges the two views.
    assert (pressed(page), page.locator("#choose-second").input_value()) == ("reasons", "color")
    page.keyboard.press("c")
    assert page.locator("#swipe").is_hidden() and page.locator("#picture-2").is_hidden()


def on_screen(page):
    """Return a function that reads the screen at every tenth pixel of a column of the picture."""
    data = page.screenshot()
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]

    def column(k):
        spots = [place(page, row, k) for row in range(20, 110, 10)]
        return np.array([picture[int(y), int(x)] for x, y in spots])

    return column


def test_two_views_side_by_side_are_zoomed_and_moved_together(page, report):
    opened(page, report, 0, "color")
    page.keyboard.press("c")
    page.select_option("#choose-how", "side")
    page.select_option("#choose-second", "reasons")
    first, second = (page.locator(n).bounding_box() for n in ("#picture", "#picture-2"))
    assert first["x"] + first["width"] <= second["x"] + 1
    row, column = np.argwhere(scene_map(page, "depth") > 0)[500]
    for canvas in ("#picture", "#picture-2"):
        box = page.locator(canvas).bounding_box()
        page.mouse.move(
            box["x"] + (column + 0.5) * box["width"] / 160,
            box["y"] + (row + 0.5) * box["height"] / 120,
        )
        assert readout(page, "pixel") == f"{column}, {row}"
        crosses = page.eval_on_selector_all(".cross", "all => all.map((c) => !c.hidden)")
        assert crosses == [canvas == "#picture-2", canvas == "#picture"]
    page.mouse.wheel(0, -400)
    page.wait_for_timeout(300)
    assert readout(page, "pixel") == f"{column}, {row}"
    first, second = (page.locator(n).bounding_box() for n in ("#picture", "#picture-2"))
    assert first["width"] > 1.5 * box["width"]
    assert np.allclose([first["width"], first["y"]], [second["width"], second["y"]], atol=0.5)
    page.keyboard.press("m")
    np.testing.assert_array_equal(canvas_pixels(page, "overlay"), canvas_pixels(page, "overlay-2"))
    page.keyboard.press("v")
    assert page.locator("#choose-how").input_value() == "swipe"
    page.keyboard.press("9")
    assert page.locator("#toggle-compare").count() == 0  # The 3D view has no comparison.
    page.keyboard.press("1")
    page.mouse.move(*place(page, row, column))
    assert readout(page, "pixel") == f"{column}, {row}"


def test_the_3d_view_starts_with_different_colours_for_parts_and_scan(page, report):
    opened(page, report, 0, "cloud")
    for name, paint in (("surfacePaint", "instance"), ("pointPaint", "difference")):
        assert page.locator(f"#choose-{name}").input_value() == paint
    page.wait_for_timeout(400)
    data = page.locator("#cloud").screenshot()
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).reshape(-1, 3)
    hue, saturation, _ = cv2.cvtColor(picture[None], cv2.COLOR_BGR2HSV)[0].T
    colorful = saturation > 100
    parts = np.unique(scene_map(page, "instance"))
    assert len(np.unique(hue[colorful] // 4)) >= min(len(parts) - 1, 4)


def test_quantised_depth_does_not_change_the_normal_of_a_plane(page, report):
    """Oracle: the plane's normal; with steps of 2 mm, central differences would be 45 deg off."""
    opened(page, report, 0)
    normals = page.evaluate(
        """() => {
            const [width, height] = [160, 120], n = width * height, tilt = 0.3;
            const depth = new Uint16Array(n), rays = new Float32Array(2 * n);
            for (let i = 0; i < n; i++) {
                rays[2 * i] = (i % width - 80) / 400;
                rays[2 * i + 1] = (Math.floor(i / width) - 60) / 400;
                depth[i] = Math.round(800 / (1 - tilt * rays[2 * i]) / 2); // z = 800 + tilt x
            }
            const view = { cam_K: [400, 0, 80, 0, 400, 60, 0, 0, 1],
                cam_R_w2c: [1, 0, 0, 0, 1, 0, 0, 0, 1], cam_t_w2c: [0, 0, 0], distortion: [0] };
            const scene = { width, height, n, rays, depth, scanner: depth, depth_scale_mm: 2,
                stride: 1, view, has: { depth: true, scanner: true } };
            const inner = Array.from(depth.keys()).filter((i) =>
                i % width > 9 && i % width < 150 && i > 9 * width && i < n - 9 * width);
            return Array.from(Graycast.shapes.normals(scene, inner));
        }"""
    )
    estimate = np.array(normals, dtype=float).reshape(-1, 3) / 127
    expected = np.array([0.3, 0, -1]) / np.hypot(0.3, 1)
    angle = np.degrees(np.arccos(np.clip(np.abs(estimate @ expected), 0, 1)))
    assert np.median(angle) < 4 and np.quantile(angle, 0.99) < 12, np.quantile(angle, 0.99)


# --- windows --------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
def test_toolbars_have_one_row_and_no_elements_overlap(page, report_with_frames, size):
    """A row that wraps is higher than its highest control; controls do not overlap."""
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.goto(report_with_frames[2].as_uri())
    ready(page, "overview")
    assert rows(page, ".filter-row") == 1 and rows(page, ".told-row") == 1
    opened(page, report_with_frames, 0)
    for view in page.eval_on_selector_all("[data-view]", "all => all.map((b) => b.dataset.view)"):
        page.click(f'[data-view="{view}"]')
        assert rows(page, ".tabs") == 1, view
        assert rows(page, ".options") == 1, view
    page.click('[data-view="pattern"]')
    page.keyboard.press("c")
    assert (rows(page, ".tabs"), rows(page, ".options")) == (1, 1)
    for name in ("body", "aside", "#instances"):
        assert page.locator(name).evaluate("(e) => e.scrollWidth <= e.clientWidth")


def rows(page, name):
    """Return the number of rows of a toolbar's controls; fail if controls overlap."""
    boxes = page.eval_on_selector_all(
        f"{name} > *",
        """all => all.map((e) => e.getBoundingClientRect())
            .filter((b) => b.width > 0 && b.height > 0)
            .map((b) => [b.left, b.top, b.right, b.bottom])""",
    )
    for k, a in enumerate(boxes):
        for b in boxes[:k]:
            apart = a[0] >= b[2] - 0.5 or b[0] >= a[2] - 0.5 or a[1] >= b[3] or b[1] >= a[3]
            assert apart, (name, a, b)
    middles = sorted((box[1] + box[3]) / 2 for box in boxes)
    return 1 + int(np.sum(np.diff(middles) > 12))
