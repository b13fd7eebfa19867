"""The page in a real browser, opened from the disk: it loads, and its controls do what they say."""

import json
import shutil

import cv2
import numpy as np
import pytest
from pictured import forget, lensed_rig, write_dataset

from graycast.frames import inverse, pixel_grid, transform_points
from graycast.optics import project, rays
from graycast.pattern import CodeSpec
from graycast.report.page import write_report

pytestmark = pytest.mark.slow
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SCENES = (0, 3, 4)
NONE = "\N{EN DASH}"  # what the page writes where there is no value


@pytest.fixture(scope="module")
def rig():
    return lensed_rig()


@pytest.fixture(scope="module")
def made(rig, tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    samples = write_dataset(folder / "bins", scene_ids=SCENES, rig=rig)
    return folder / "bins", samples, write_report(folder / "bins", folder / "page").page


@pytest.fixture(scope="module")
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


def ready(page, name):
    page.wait_for_selector(f'#main[data-ready="{name}"]')


def opened(page, made, scene_id, view=None):
    page.goto(f"{made[2].as_uri()}#/train-{scene_id:06d}")
    ready(page, f"train-{scene_id:06d}")
    if view:
        page.click(f'[data-view="{view}"]')


def held(page, name):
    return np.array(page.evaluate(f"Array.from(Graycast.opened().scene.{name})")).reshape(120, 160)


def shown(page, canvas="picture"):
    """What a canvas shows; a copy is read, as browsers complain of slow canvases read often."""
    data = page.evaluate(
        """(name) => {
            const copy = document.createElement("canvas");
            [copy.width, copy.height] = [160, 120];
            const context = copy.getContext("2d", { willReadFrequently: true });
            context.drawImage(document.getElementById(name), 0, 0);
            return Array.from(context.getImageData(0, 0, 160, 120).data);
        }""",
        canvas,
    )
    return np.array(data, dtype=np.uint8).reshape(120, 160, 4)


def place(page, row, column):
    """Where a pixel of the picture is on the screen."""
    box = page.locator("#picture").bounding_box()
    return (
        box["x"] + (column + 0.5) * box["width"] / 160,
        box["y"] + (row + 0.5) * box["height"] / 120,
    )


def readout(page, name):
    return page.locator(f'#readout tr[data-name="{name}"] td').inner_text()


def test_the_browser_holds_the_dataset_s_numbers(page, made):
    """Oracle: the PNGs, pixel by pixel, through packing, JavaScript and back."""
    dataset, samples, _ = made
    for scene_id in SCENES:
        opened(page, made, scene_id)
        folder = dataset / f"train/{scene_id:06d}"
        for ours, theirs in (("depth", "depth"), ("scanner", "depth_sl"), ("reason", "reason_sl")):
            stored = cv2.imread(str(folder / theirs / "000000.png"), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(held(page, ours), stored)
        np.testing.assert_array_equal(held(page, "instance") - 1, samples[scene_id].truth.instance)


@pytest.mark.parametrize("which", ["depth", "scanner"])
def test_projector_positions_are_those_of_the_optics(page, made, rig, which):
    """Oracle: `optics.rays` and `project`, through both lenses' distortion."""
    opened(page, made, 0)
    step = held(page, which)
    ray = rays(rig.camera, pixel_grid(120, 160))
    point = ray * np.where(step > 0, step * 1e-4, np.nan)[..., None]
    expected = project(rig.projector, transform_points(inverse(rig.T_cam_proj), point))
    inside = ((expected > -0.49) & (expected < [159.49, 119.49])).all(axis=-1)
    assert inside.sum() > 3000
    for k, name in enumerate(("column", "row")):
        found = page.evaluate(
            f"Array.from(Graycast.projectorMap(Graycast.opened().scene, '{which}').{name},"
            " (v) => Number.isNaN(v) ? -1 : v)"
        )
        found = np.array(found).reshape(120, 160)
        assert np.abs(found - expected[..., k])[inside].max() < 2e-3
        outside = ((expected < -0.51) | (expected > [159.51, 119.51])).any(axis=-1)
        assert (found[outside | (step == 0)] == -1).all()


def test_pattern_bits_are_the_code_s(page, made):
    opened(page, made, 0, "pattern")
    page.click("#toggle-shade")
    patterns = CodeSpec().code(160, 120).render()
    column, row = (
        np.array(
            page.evaluate(
                f"Array.from(Graycast.projectorMap(Graycast.opened().scene, 'scanner').{axis},"
                " (v) => Number.isNaN(v) ? -1 : Math.round(v))"
            ),
            dtype=int,
        ).reshape(120, 160)
        for axis in ("column", "row")
    )
    known = column >= 0
    for k in (2, 9, 10, 16):
        page.select_option("#choose-frame", str(k))
        np.testing.assert_array_equal(
            shown(page)[known][:, 0], patterns[k][row[known], column[known]]
        )
    before = page.locator("#choose-frame").input_value()
    page.keyboard.press("]")
    assert int(page.locator("#choose-frame").input_value()) == (int(before) + 1) % 17


def test_values_under_the_pointer_are_the_files_(page, made):
    opened(page, made, 3)
    step, scanner = held(page, "depth"), held(page, "scanner")
    instance = held(page, "instance") - 1
    for row, column in ((47, 75), (10, 12), *np.argwhere((instance >= 0) & (scanner > 0))[::700]):
        page.mouse.move(*place(page, row, column))
        assert readout(page, "pixel") == f"{column}, {row}"
        assert readout(page, "perfect") == f"{step[row, column] / 10:.1f} mm"
        expected = f"{scanner[row, column] / 10:.1f} mm" if scanner[row, column] else NONE
        assert readout(page, "scanner") == expected
        k = instance[row, column]
        name = f"{k} {('box', 'wedge')[k % 2]}" if k >= 0 else NONE
        assert readout(page, "instance") == name
    page.mouse.move(*place(page, 47, 75))
    assert readout(page, "reason") == "shadow"


def test_masks_and_boxes_can_be_switched_and_name_what_is_under_the_pointer(page, made):
    opened(page, made, 0)
    instance = held(page, "instance") - 1
    assert not shown(page, "overlay").any()
    page.keyboard.press("m")
    covered = shown(page, "overlay")[..., 3] > 0
    np.testing.assert_array_equal(covered, instance >= 0)
    page.keyboard.press("b")
    seen = np.unique(instance[instance >= 0])
    assert page.locator("#boxes rect.visible").count() == len(seen)
    row, column = np.argwhere(instance == seen[0])[0]
    page.mouse.move(*place(page, row, column))
    assert page.locator("#tip").inner_text() == f"{seen[0]} {('box', 'wedge')[seen[0] % 2]}"
    for key in "mb":
        page.keyboard.press(key)
    assert not shown(page, "overlay").any() and page.locator("#boxes rect").count() == 0


def test_a_reason_in_the_legend_leaves_its_pixels_bright(page, made):
    opened(page, made, 0, "reasons")
    page.hover("#reasons div:has-text('shadow')")
    np.testing.assert_array_equal(shown(page, "overlay")[..., 3] == 0, held(page, "reason") == 1)


def test_views_flip_by_keys_and_the_difference_is_white_where_there_is_none(page, made):
    opened(page, made, 0)
    page.keyboard.press("7")
    assert page.locator('[aria-pressed="true"]').inner_text().endswith("Difference")
    same = (held(page, "depth") == held(page, "scanner")) & (held(page, "depth") > 0)
    assert (shown(page)[same][:, :3] > 240).all()
    page.keyboard.press("6")
    page.keyboard.press("Space")
    assert page.locator('[aria-pressed="true"]').inner_text().endswith("Difference")
    page.keyboard.press("ArrowRight")
    ready(page, "train-000003")
    page.keyboard.press("ArrowLeft")
    ready(page, "train-000000")
    page.keyboard.press("Escape")
    ready(page, "overview")


def test_zoom_keeps_the_pixel_under_the_pointer(page, made):
    opened(page, made, 0)
    page.mouse.move(*place(page, 80, 33))
    for _ in range(3):
        page.mouse.wheel(0, -300)
        page.wait_for_timeout(50)
    assert page.locator("#picture").bounding_box()["width"] > 1500
    assert readout(page, "pixel") == "33, 80"
    page.keyboard.press("0")
    assert page.locator("#picture").bounding_box()["width"] < 1200


def test_the_grid_filters_sorts_and_opens_scenes(page, made):
    cards = page.locator(".card")
    assert cards.count() == 3
    rows = page.evaluate("Graycast.rows().map((r) => [r.key, r.decoded, r.visibility])")
    page.select_option("#pick-sort", "decoded")
    page.click("#direction")
    expected = [key for key, *_ in sorted(rows, key=lambda row: -row[1])]
    assert page.evaluate("Graycast.filtered().map((r) => r.key)") == expected
    middle = sorted(row[2] for row in rows)[1]
    page.fill("#visibility-from", str(100 * middle - 1e-4))
    assert cards.count() == sum(row[2] >= middle for row in rows) < 3
    page.click("#reset")
    assert cards.count() == 3
    page.select_option("#pick-thumb", "reason.png")
    page.wait_for_function(
        "[...document.querySelectorAll('.card img')].every((i) => i.naturalWidth)"
    )
    cards.nth(1).click()
    ready(page, "train-000003")


def test_the_3d_view_draws_what_is_switched_on(page, made):
    def colors():
        page.wait_for_timeout(400)
        data = page.locator("#cloud").screenshot()
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return len(np.unique(picture.reshape(-1, 3), axis=0)), picture

    opened(page, made, 0, "cloud")
    page.click("text=camera")  # the side of the surface that is drawn is the one the camera saw
    both, first = colors()
    page.keyboard.press("s")
    points, second = colors()
    page.keyboard.press("p")
    nothing, _ = colors()
    assert both > 1000 and points > 30
    assert nothing < 20  # the ground, and its rounded corners
    assert np.abs(first.astype(int) - second).mean() > 1
    page.keyboard.press("s")
    surface, before = colors()
    assert surface > 1000
    page.click("text=oblique")
    _, after = colors()
    assert np.abs(before.astype(int) - after).mean() > 1


def test_light_and_dark_can_be_read(page, made):
    """Text against its ground has a contrast of 7 and more in both."""

    def contrast():
        tone = page.evaluate(
            "(() => { const s = getComputedStyle(document.documentElement);"
            " return [s.color, s.backgroundColor].map((c) => c.match(/\\d+/g).map(Number)); })()"
        )
        linear = np.where(
            np.array(tone) / 255 <= 0.04045,
            np.array(tone) / 255 / 12.92,
            ((np.array(tone) / 255 + 0.055) / 1.055) ** 2.4,
        )
        low, high = sorted(linear @ [0.2126, 0.7152, 0.0722])
        return (high + 0.05) / (low + 0.05)

    first = page.evaluate("document.documentElement.dataset.theme")
    assert contrast() > 7
    page.keyboard.press("t")
    assert page.evaluate("document.documentElement.dataset.theme") != first
    assert contrast() > 7


def test_a_scene_that_is_not_there_is_said(page, made):
    page.goto(f"{made[2].as_uri()}#/train-000777")
    ready(page, "train-000777")
    assert "no scene train-000777" in page.locator(".sorry").inner_text()


def test_real_pictures_show_what_they_have(page, rig, tmp_path):
    write_dataset(tmp_path / "real", scene_ids=(3,), rig=rig)
    forget(tmp_path / "real/train/000003")
    claim = tmp_path / "real/graycast.json"
    held = json.loads(claim.read_bytes())
    claim.write_text(json.dumps({"kind": "real", "parts": held["parts"]}))
    made = write_report(tmp_path / "real", tmp_path / "page").page
    page.goto(f"{made.as_uri()}#/train-000003")
    ready(page, "train-000003")
    views = page.eval_on_selector_all(".tabs button", "all => all.map((b) => b.dataset.view)")
    assert views == ["color", "scanner", "reasons", "cloud"]
    for view in reversed(views):
        page.click(f'[data-view="{view}"]')
    page.mouse.move(*place(page, 47, 75))
    assert (readout(page, "perfect"), readout(page, "reason")) == (NONE, "missing")
    page.keyboard.press("Escape")
    ready(page, "overview")
