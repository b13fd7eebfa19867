"""The page in a real browser, opened from the disk: it loads, and its controls work."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from dataset.prisms import SCALE_MM
from pictured import forget, write_dataset

from graycast.base.frames import inverse, pixel_grid, transform_points
from graycast.rig.optics import project, rays
from graycast.rig.pattern import CodeSpec
from graycast.show.report.page import write_report

from .browsing import SCENES, canvas_pixels, opened, place, pressed, readout, ready, scene_map

pytestmark = pytest.mark.slow
NONE = "\N{EN DASH}"  # the page's text for a missing value


def test_the_browser_shows_the_numbers_of_the_dataset(page, report):
    """Oracle: the PNGs, pixel by pixel; the page's values went through packing and JavaScript."""
    dataset, samples, _ = report
    for scene_id in SCENES:
        opened(page, report, scene_id)
        folder = dataset / f"train/{scene_id:06d}"
        for ours, theirs in (("depth", "depth"), ("scanner", "depth_sl"), ("reason", "reason_sl")):
            stored = cv2.imread(str(folder / theirs / "000000.png"), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(scene_map(page, ours), stored)
        np.testing.assert_array_equal(
            scene_map(page, "instance") - 1, samples[scene_id].truth.instance
        )


@pytest.mark.parametrize("which", ["depth", "scanner"])
def test_projector_positions_in_the_browser_agree_with_optics(page, report, rig, which):
    """Oracle: `optics.rays` and `project`, with the distortion of both lenses."""
    opened(page, report, 0)
    step = scene_map(page, which)
    ray = rays(rig.camera, pixel_grid(120, 160))
    point = ray * np.where(step > 0, step * SCALE_MM * 1e-3, np.nan)[..., None]
    expected = project(rig.projector, transform_points(inverse(rig.T_cam_proj), point))
    inside = ((expected > -0.49) & (expected < [159.49, 119.49])).all(axis=-1)
    assert inside.sum() > 3000
    for k, name in enumerate(("column", "row")):
        positions = page.evaluate(
            f"Array.from(Graycast.projectorMap(Graycast.opened().scene, '{which}').{name},"
            " (v) => Number.isNaN(v) ? -1 : v)"
        )
        positions = np.array(positions).reshape(120, 160)
        assert np.abs(positions - expected[..., k])[inside].max() < 2e-3
        outside = ((expected < -0.51) | (expected > [159.51, 119.51])).any(axis=-1)
        assert (positions[outside | (step == 0)] == -1).all()


@pytest.mark.parametrize(
    ("distortion", "folds"),
    [
        ((-0.12, 0.05, 0.001, -0.0007, 0.0), False),
        ((0.3, 0.1, -0.01, 0.02, 0.05), False),
        ((-0.6, 0.0, 0.0, 0.0, 0.0), False),
        ((-2.0, 0.0, 0.0, 0.0, 0.0), True),
        ((1.0, -20.0, 0.0, 0.0, 0.0), True),
        ((0.0, 0.0, 0.9, 0.0, 0.0), True),
    ],
)
def test_the_browser_refuses_the_same_rays_as_optics(page, report, rig, distortion, folds):
    """Oracle: `optics.rays`, which refuses a lens that folds over within the picture."""
    opened(page, report, 0)
    result = page.evaluate(
        """(distortion) => {
            const scene = { ...Graycast.opened().scene, rays: null };
            scene.view = { ...scene.view, distortion };
            try {
                return Array.from(Graycast.rays(scene));
            } catch (error) {
                return error.message;
            }
        }""",
        distortion,
    )
    lens = replace(rig.camera, distortion=distortion)
    if folds:
        assert "has no inverse over this picture" in result
        with pytest.raises(ValueError, match="no inverse"):
            rays(lens, pixel_grid(120, 160))
    else:
        expected = rays(lens, pixel_grid(120, 160))[..., :2]
        assert np.abs(np.reshape(result, (120, 160, 2)) - expected).max() < 1e-6


@pytest.mark.parametrize("k", [(-1.5, 0.0, 0.0), (-2.0, 1.0, 0.0), (0.1, -3.0, 0.2)])
def test_points_beyond_the_turning_point_of_distortion_have_no_position(page, report, rig, k):
    """Oracle: `optics.project`; beyond the fold, the polynomial returns into the picture."""
    opened(page, report, 0)
    lens = replace(rig.projector, distortion=(k[0], k[1], 0.0, 0.0, k[2]))
    result = page.evaluate(
        """(distortion) => {
            Graycast.report.scanners[""].rig.projector.distortion = distortion;
            const scene = { ...Graycast.opened().scene, projected: null };
            return Array.from(Graycast.projectorMap(scene, "depth").column, (v) => v === v);
        }""",
        lens.distortion,
    )
    step = scene_map(page, "depth")
    point = rays(rig.camera, pixel_grid(120, 160)) * (step * SCALE_MM * 1e-3)[..., None]
    expected = project(lens, transform_points(inverse(rig.T_cam_proj), point))
    ended = np.isnan(expected).any(axis=-1) & (step > 0)
    inside = ((expected > -0.49) & (expected < [159.49, 119.49])).all(axis=-1) & (step > 0)
    assert ended.sum() > 30 and inside.sum() > 300
    result = np.reshape(result, (120, 160))
    assert not result[ended].any() and result[inside].all()


def test_a_lens_without_an_inverse_is_reported_if_its_rays_are_needed(page, report):
    opened(page, report, 0)
    page.evaluate(
        """() => {
            const { scene } = Graycast.opened();
            scene.view.distortion = [-2, 0, 0, 0, 0];
            scene.rays = scene.projected = null;
        }"""
    )
    page.click('[data-view="column"]')
    page.wait_for_selector(".note:has-text('has no inverse over this picture')")
    page.click('[data-view="cloud"]')
    page.wait_for_selector(".stage.cloud .sorry:has-text('has no inverse over this picture')")
    page.click('[data-view="scanner"]')
    assert pressed(page) == "scanner"


def test_pattern_bits_in_the_browser_equal_those_of_the_code(page, report):
    opened(page, report, 0, "pattern")
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
            canvas_pixels(page)[known][:, 0], patterns[k][row[known], column[known]]
        )
    before = page.locator("#choose-frame").input_value()
    page.keyboard.press("]")
    assert int(page.locator("#choose-frame").input_value()) == (int(before) + 1) % 17


def slide(page, k):
    """Move the slider to a frame, and wait until the frame is shown."""
    page.evaluate(
        """(k) => {
            const slider = document.getElementById("frame-slider");
            slider.value = k;
            slider.dispatchEvent(new Event("input"));
        }""",
        k,
    )
    wait_for_frame(page, k)


def wait_for_frame(page, k):
    page.wait_for_function(
        f"Graycast.prefs.frame === {k} && Graycast.opened().scene.frames.levels.has({k})"
    )


def grey(sample):
    """Return frames in sRGB: black is the sensor's offset, and white is its saturation."""
    sensor = sample.raw.capture.sensor
    share = (sample.raw.capture.frames - sensor.offset_dn) / (
        sensor.saturation_dn - sensor.offset_dn
    )
    return encoded(share)


def encoded(share):
    """Return the sRGB encoding by IEC 61966-2-1, from 0 to 255."""
    share = share.clip(0, 1)
    return 255 * np.where(share < 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("gain", [1, 4])
def test_dark_pictures_can_be_brightened(page, report_with_frames, gain):
    """Oracle: the dataset's linear picture times the gain, encoded by IEC 61966-2-1."""
    opened(page, report_with_frames, 0, "white")
    page.select_option("#choose-gain", str(gain))
    stored = cv2.imread(
        str(report_with_frames[0] / "train/000000/gray_sl/000000.png"), cv2.IMREAD_UNCHANGED
    )
    picture = canvas_pixels(page)[..., 0].astype(float)
    assert np.median(np.abs(picture - encoded(gain * (stored / 255)))) < 4  # noise of JPEG
    x, y = place(page, 60, 80)
    page.mouse.move(x, y)
    level = int(readout(page, "white frame").split()[1])
    assert level == pytest.approx(float(stored[60, 80]), abs=25)  # independent of the gain
    page.select_option("#choose-gain", "1")


def test_captured_frames_are_loaded_only_when_they_are_shown(page, report_with_frames):
    opened(page, report_with_frames, 0)
    assert page.evaluate("!Graycast.opened().scene.frames && !Graycast.opened().scene.columns")
    stored = grey(report_with_frames[1][0])
    page.click('[data-view="pattern"]')
    for k in (0, 1, 2, 9, 17):
        slide(page, k)
        picture = canvas_pixels(page)[..., 0].astype(float)
        miss = np.abs(picture - stored).mean(axis=(1, 2))
        assert miss.argmin() == k and miss[k] < 4, miss  # noise of JPEG
        assert page.locator("#choose-frame").input_value() == str(k)
    assert "captured, 12 bit" in page.locator("span.note").inner_text()


def test_arrow_keys_bracket_keys_and_play_change_the_frame(page, report_with_frames):
    opened(page, report_with_frames, 0, "pattern")
    slide(page, 16)
    for key, k in (("ArrowDown", 17), ("]", 0), ("ArrowUp", 17), ("[", 16)):
        page.keyboard.press(key)
        wait_for_frame(page, k)
    page.locator("#frame-slider").focus()
    page.keyboard.press("ArrowLeft")  # The slider uses this key.
    wait_for_frame(page, 15)
    page.keyboard.press("p")
    assert page.locator("#frame-play").get_attribute("aria-pressed") == "true"
    wait_for_frame(page, 17)
    page.keyboard.press("p")
    stopped = page.evaluate("Graycast.prefs.frame")
    page.wait_for_timeout(700)
    assert page.evaluate("Graycast.prefs.frame") == stopped
    page.keyboard.press("p")
    page.keyboard.press("1")  # In another view, the keys must not change the frame.
    page.wait_for_timeout(700)
    assert page.evaluate("Graycast.prefs.frame") in (stopped, stopped + 1)
    page.keyboard.press("3")
    assert page.locator("#frame-play").get_attribute("aria-pressed") == "false"


def test_ideal_bits_are_shown_next_to_captured_frames(page, report_with_frames):
    opened(page, report_with_frames, 3, "pattern")
    slide(page, 2)
    captured = canvas_pixels(page)[..., 0]
    page.select_option("#choose-source", "scanner")
    assert "ideal bits" in page.locator("span.note").inner_text()
    known = scene_map(page, "scanner") > 0
    page.click("#toggle-shade")
    ideal = canvas_pixels(page)[..., 0]
    assert set(np.unique(ideal[known])) == {0, 255}
    lit = captured > np.median(captured[known])
    assert (lit == (ideal == 255))[known].mean() > 0.9


@pytest.mark.parametrize("axis", ["column", "sigma_column", "row", "sigma_row"])
def test_decoded_positions_on_the_page_equal_the_stored_positions(page, report_with_frames, axis):
    """Oracle: the code map in memory; the page's values went through TIFF, packing, JavaScript."""
    opened(page, report_with_frames, 0, "column")
    page.select_option("#choose-axis", axis)
    page.wait_for_function("Graycast.opened().scene.columns.maps")
    positions = np.array(
        page.evaluate(
            f"Array.from(Graycast.opened().scene.columns.maps.{axis},"
            " (v) => Number.isNaN(v) ? null : v)"
        ),
        dtype=float,
    ).reshape(120, 160)
    stored = getattr(report_with_frames[1][0].raw.codes, axis)
    np.testing.assert_allclose(positions, stored, atol=2e-3)
    unknown = np.isnan(stored)
    assert (canvas_pixels(page)[unknown][:, :3] == [58, 60, 66]).all() and unknown.any()
    assert len(np.unique(canvas_pixels(page)[~unknown][:, :3], axis=0)) > (
        0 if "sigma" in axis else 40
    )


def test_frame_and_column_under_the_pointer_are_shown(page, report_with_frames):
    opened(page, report_with_frames, 3, "column")
    page.wait_for_function("Graycast.opened().scene.columns.maps")
    sample = report_with_frames[1][3]
    codes, shot = sample.raw.codes, sample.raw.capture
    page.click('[data-view="pattern"]')
    slide(page, 0)
    off_dn = []
    for row, column in np.argwhere(np.isfinite(codes.column))[::1500]:
        page.mouse.move(*place(page, row, column))
        for axis in ("column", "row"):
            value, sigma = getattr(codes, axis), getattr(codes, f"sigma_{axis}")
            words = readout(page, f"decoded {axis}").split()
            assert abs(float(words[0]) - value[row, column]) < 0.01
            assert abs(float(words[2]) - sigma[row, column]) < 0.01
        words = readout(page, "this frame").split()
        off_dn.append(int(words[1]) - int(shot.frames[0, row, column]))
    assert np.abs(off_dn).max() < 200 and abs(np.mean(off_dn)) < 30  # noise of JPEG, of 4095
    row, column = np.argwhere(np.isnan(codes.column))[20]
    page.mouse.move(*place(page, row, column))
    assert readout(page, "decoded column") == NONE


def test_missing_data_are_named_with_the_key_that_stores_them(page, report):
    opened(page, report, 0, "pattern")
    assert "store: {frames: true}" in page.locator("span.note").inner_text()
    page.click('[data-view="column"]')
    assert "store: {columns: true}" in page.locator("span.note").inner_text()
    names = page.eval_on_selector_all("#choose-axis option", "all => all.map((o) => o.value)")
    assert names == ["column", "row"]
    assert page.locator('#readout tr[data-name="decoded column"]').count() == 0


def test_deleted_frames_are_reported(browser, report_with_frames, tmp_path):
    page_folder = shutil.copytree(report_with_frames[2].parent, tmp_path / "page")
    (page_folder / "scenes/train-000000/frames.js").unlink()
    page = browser.new_page()
    page.goto(f"{(page_folder / 'index.html').as_uri()}#/train-000000")
    ready(page, "train-000000")
    page.click('[data-view="pattern"]')
    page.wait_for_selector(".note:has-text('run graycast report again')")
    page.click('[data-view="scanner"]')
    assert pressed(page) == "scanner"
    page.close()


def test_values_under_the_pointer_equal_those_in_the_files(page, report):
    opened(page, report, 3)
    step, scanner = scene_map(page, "depth"), scene_map(page, "scanner")
    instance = scene_map(page, "instance") - 1
    for row, column in ((47, 75), (10, 12), *np.argwhere((instance >= 0) & (scanner > 0))[::700]):
        page.mouse.move(*place(page, row, column))
        assert readout(page, "pixel") == f"{column}, {row}"
        assert readout(page, "perfect") == f"{SCALE_MM * step[row, column]:.2f} mm"
        expected = f"{SCALE_MM * scanner[row, column]:.2f} mm" if scanner[row, column] else NONE
        assert readout(page, "scanner") == expected
        k = instance[row, column]
        name = f"{k} {('box', 'wedge')[k % 2]}" if k >= 0 else NONE
        assert readout(page, "instance") == name
    page.mouse.move(*place(page, 47, 75))
    assert readout(page, "reason") == "shadow"


def test_masks_and_boxes_can_be_hidden_and_are_named_under_the_pointer(page, report):
    opened(page, report, 0)
    instance = scene_map(page, "instance") - 1
    assert not canvas_pixels(page, "overlay").any()
    page.keyboard.press("m")
    covered = canvas_pixels(page, "overlay")[..., 3] > 0
    np.testing.assert_array_equal(covered, instance >= 0)
    page.keyboard.press("b")
    visible = np.unique(instance[instance >= 0])
    assert page.locator("#boxes rect.visible").count() == len(visible)
    row, column = np.argwhere(instance == visible[0])[0]
    page.mouse.move(*place(page, row, column))
    assert page.locator("#tip").inner_text() == f"{visible[0]} {('box', 'wedge')[visible[0] % 2]}"
    for key in "mb":
        page.keyboard.press(key)
    assert not canvas_pixels(page, "overlay").any() and page.locator("#boxes rect").count() == 0


def test_a_reason_selected_in_the_legend_highlights_its_pixels(page, report):
    opened(page, report, 0, "reasons")
    page.hover("#reasons div:has-text('shadow')")
    np.testing.assert_array_equal(
        canvas_pixels(page, "overlay")[..., 3] == 0, scene_map(page, "reason") == 1
    )


def test_keys_change_the_view_and_a_zero_difference_is_white(page, report):
    opened(page, report, 0)
    page.keyboard.press("7")
    assert pressed(page) == "difference"
    same = (scene_map(page, "depth") == scene_map(page, "scanner")) & (scene_map(page, "depth") > 0)
    assert (canvas_pixels(page)[same][:, :3] > 240).all()
    page.keyboard.press("6")
    page.keyboard.press("Space")
    assert pressed(page) == "difference"
    page.keyboard.press("ArrowRight")
    ready(page, "train-000003")
    page.keyboard.press("ArrowLeft")
    ready(page, "train-000000")
    page.keyboard.press("Escape")
    ready(page, "overview")


def test_the_layout_of_a_picture_is_known_when_its_scene_is_ready(page, report):
    first, later = page.evaluate(
        """async () => {
            const main = document.getElementById("main"), name = "train-000003";
            const place = () => JSON.stringify(
                document.getElementById("picture").getBoundingClientRect());
            const seen = new Promise((done) => new MutationObserver((_, self) => {
                if (main.dataset.ready !== name) return;
                self.disconnect();
                done(place());
            }).observe(main, { attributes: true }));
            location.hash = `#/${name}`;
            const first = await seen;
            for (let k = 0; k < 3; k++) await new Promise(requestAnimationFrame);
            return [first, place()];
        }"""
    )
    assert first == later


def test_zooming_keeps_the_same_pixel_under_the_pointer(page, report):
    opened(page, report, 0)
    page.mouse.move(*place(page, 80, 33))
    for _ in range(3):
        page.mouse.wheel(0, -300)
    width = "document.querySelector('#picture').getBoundingClientRect().width"
    page.wait_for_function(f"{width} > 1500")
    page.wait_for_timeout(300)  # until the last event of the wheel has been processed
    assert readout(page, "pixel") == "33, 80"
    page.keyboard.press("0")
    assert page.locator("#picture").bounding_box()["width"] < 1200


def test_the_grid_filters_sorts_and_opens_scenes(page, report):
    cards = page.locator(".card")
    assert cards.count() == 3
    rows = page.evaluate("Graycast.rows().map((r) => [r.key, r.decoded, r.visibility])")
    page.select_option("#pick-sort", "decoded")
    page.click("#direction")
    expected = [key for key, *_ in sorted(rows, key=lambda row: -row[1])]
    assert page.evaluate("Graycast.filtered().map((r) => r.key)") == expected
    middle = sorted(row[2] for row in rows)[1]
    page.click("#more summary")
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


def test_the_3d_view_draws_the_selected_layers(page, report):
    def colors():
        page.wait_for_timeout(400)
        data = page.locator("#cloud").screenshot()
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return len(np.unique(picture.reshape(-1, 3), axis=0)), picture

    opened(page, report, 0, "cloud")
    page.select_option("#choose-surfacePaint", "colour")
    page.select_option("#choose-pointPaint", "difference")
    page.click("text=camera")  # The surface is drawn only on the side that the camera saw.
    both, first = colors()
    page.keyboard.press("s")
    points, second = colors()
    page.keyboard.press("p")
    nothing, _ = colors()
    assert both > 1000 and points > 30
    assert nothing < 20  # the background and its rounded corners
    assert np.abs(first.astype(int) - second).mean() > 1
    page.keyboard.press("s")
    surface, before = colors()
    assert surface > 1000
    page.click("text=oblique")
    _, after = colors()
    assert np.abs(before.astype(int) - after).mean() > 1


def test_light_and_dark_themes_are_readable(page, report):
    """The contrast between text and background is at least 7 in both themes."""

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


def test_a_missing_scene_is_reported(page, report):
    page.goto(f"{report[2].as_uri()}#/train-000777")
    ready(page, "train-000777")
    assert "no scene train-000777" in page.locator(".sorry").inner_text()


def test_pages_of_real_pictures_show_their_data(page, rig, tmp_path):
    write_dataset(tmp_path / "real", scene_ids=(3,), rig=rig)
    forget(tmp_path / "real")
    path = write_report(tmp_path / "real", tmp_path / "page").page
    page.goto(f"{path.as_uri()}#/train-000003")
    ready(page, "train-000003")
    views = page.eval_on_selector_all("[data-view]", "all => all.map((b) => b.dataset.view)")
    assert views == ["color", "scanner", "reasons", "cloud"]
    for view in reversed(views):
        page.click(f'[data-view="{view}"]')
    page.mouse.move(*place(page, 47, 75))
    assert (readout(page, "perfect"), readout(page, "reason")) == (NONE, "missing")
    page.keyboard.press("Escape")
    ready(page, "overview")
