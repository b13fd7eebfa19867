"""The page in Chromium: every control works, and all resources are released at the end."""

import os
import random
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from small_cell import write_cell

from graycast.cell.config import load_config
from graycast.cell.resolve import open_cell_renderer, resolve_cell
from graycast.cell.simulate import make_scene
from graycast.show.live import serve

pytestmark = pytest.mark.slow
WAIT_MS = 120_000
POLLING_MS = 50  # This replaces polling at every frame, because a busy machine may draw no frame.
MOVES = 100


@pytest.fixture
def server(tmp_path):
    cell = write_cell(tmp_path, render={"samples": 1}, filters={"outlier_sigmas": 4.0})
    with serve(cell, port=0, scene_id=0, device="cpu") as running:
        yield running


@pytest.fixture
def page(browser, server):
    """Open the page and wait for its cell; any message of the browser fails the test."""
    complaints = []
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(server.url)
    finished(page)
    page.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    yield page
    page.close()
    assert complaints == []


def finished(page, *, may_fail=False):
    """Wait until the last request is shown with all configured samples; an error ends the wait."""
    from playwright.sync_api import TimeoutError

    try:
        page.wait_for_function(
            """() => { const d = document.getElementById("main").dataset;
            const ended = (d.exact === "true" && d.shown === d.asked) || d.failed === d.asked;
            return ended && d.asked !== undefined; }""",  # at first, both are missing
            timeout=WAIT_MS,
            polling=POLLING_MS,
        )
    except TimeoutError as error:
        there = page.evaluate(
            """() => [{ ...document.getElementById("main").dataset }, Graycast.live.errors,
            document.getElementById("doing").textContent]"""
        )
        raise AssertionError(f"no finished picture after {WAIT_MS} ms: {there}") from error
    if not may_fail:
        assert page.locator("#error").is_hidden(), page.locator("#error").inner_text()


def act_and_wait(page, act, *, may_fail=False):
    """Perform an action, and wait for its picture."""
    before = page.get_attribute("#main", "data-asked")
    act()
    page.wait_for_function(
        "(before) => document.getElementById('main').dataset.asked !== before",
        arg=before,
        timeout=WAIT_MS,
        polling=POLLING_MS,
    )
    finished(page, may_fail=may_fail)


def scene_map(page, name):
    return np.array(page.evaluate(f"Array.from(Graycast.opened().scene.{name})")).reshape(
        page.evaluate("[Graycast.opened().scene.height, Graycast.opened().scene.width]")
    )


def controls(page):
    return page.evaluate("Graycast.opened().state.controls")


def other_value(control, now):
    """Return another value within the bounds, close enough that the scene stays visible."""
    low, high, step = control["low"], control["high"], control.get("step")
    if step is None:
        return float(f"{now * 1.3 if now * 1.3 < high else now / 1.3:.4g}")
    share = {"free": 1 / 4, "light": 1 / 20, "physics": 0.0}[control["cost"]]
    away = max(step, share * (high - low))
    value = now + away if now + away <= high else now - away
    return round(value / step) * step


def field(page, control):
    return page.locator(f'[data-key="{control["key"]}"] input[type=number]')


def control_value(page, control):
    return float(field(page, control).input_value()) / control.get("scale", 1)


def compared(page, server, renderer):
    """Compare the page with the result of `make_scene` for the saved file."""
    path = server.session.save("saved.yaml")
    cell = resolve_cell(load_config(path), path.parent)
    shot = make_scene(cell, 0, seed=cell.config.seed, renderer=renderer)
    scale_mm = page.evaluate("Graycast.opened().scene.depth_scale_mm")
    for name, depth in (("depth", shot.sample.truth), ("scanner", shot.sample.scanner_depth)):
        step = np.rint(np.nan_to_num(depth.depth_m) * (1000 / scale_mm)).astype(int)
        np.testing.assert_array_equal(scene_map(page, name), step, err_msg=name)
    np.testing.assert_array_equal(scene_map(page, "reason"), shot.sample.scanner_depth.reason)


def test_every_control_changes_its_setting_and_the_shown_picture(page, server):
    """Oracle: the file that Save writes, read by `load_config` and rendered by `make_scene`."""
    cell = resolve_cell(load_config(server.session._path), server.session._path.parent)
    done = set()
    with open_cell_renderer(cell, device="cpu") as renderer:
        for control in controls(page):
            key = control["key"]
            if key in ("rig", "resolution") or key.endswith("builtin"):
                continue  # The options of a choice come from lists that are tested elsewhere.
            if "choices" in control:
                label = {
                    "exposure.factors": "1 + 0.25",
                    "code.codec": "gray phase",
                    "render.samples": "4",
                }[key]
                select = page.locator(f'[data-key="{key}"] select')
                act_and_wait(page, partial(select.select_option, label=label))
                assert select.locator("option:checked").inner_text() == label
            else:
                number = field(page, control)
                now = number.input_value()
                start = float(now) / control.get("scale", 1) if now else 0.004
                value = other_value(control, start)
                number.fill(f"{value * control.get('scale', 1):.6g}")
                act_and_wait(page, partial(number.press, "Enter"))
                assert control_value(page, control) == pytest.approx(value, rel=2e-3, abs=1e-9)
            compared(page, server, renderer)
            done.add(key)
            act_and_wait(page, lambda: page.click("#undo"))
    assert len(done) > 45 and page.evaluate("Graycast.live.errors") == []


def test_moving_a_slider_is_a_single_undo_step(page):
    slider = page.locator('[data-key="exposure.target"] input[type=range]')
    slider.focus()
    before = page.locator("#text").input_value()
    for value in ("0.3", "0.4", "0.5"):
        slider.evaluate("(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }", value)
    act_and_wait(page, lambda: slider.evaluate("(e) => e.dispatchEvent(new Event('change'))"))
    slider.blur()
    assert "target: 0.5" in page.locator("#text").input_value()
    act_and_wait(page, lambda: page.click("#undo"))
    assert page.locator("#text").input_value() == before


def test_the_rig_can_be_dragged_in_the_3d_view(page):
    x, y = page.evaluate("Graycast.opened().world.handles()[0]")
    box = page.locator("#cloud").bounding_box()
    x, y = box["x"] + x, box["y"] + y
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 20, y + 10, steps=4)
    act_and_wait(page, page.mouse.up)
    values = page.evaluate("Graycast.opened().header.values")
    assert values["view.azimuth_deg"] == pytest.approx(7.0)
    assert values["view.tilt_deg"] == pytest.approx(3.5)
    act_and_wait(page, lambda: page.click("#undo"))
    assert page.evaluate("Graycast.opened().header.values['view.tilt_deg']") == 0


def test_two_settings_are_shown_side_by_side_and_one_can_be_restored(page):
    page.click("#hold")
    before = scene_map(page, "reason")
    number = page.locator('[data-key="exposure.target"] input[type=number]')
    number.fill("0.05")
    act_and_wait(page, lambda: number.press("Enter"))
    other = np.array(page.evaluate("Array.from(Graycast.opened().held.reason)"))
    np.testing.assert_array_equal(other, before.ravel())
    assert (scene_map(page, "reason") != before).any()
    assert page.locator(".pane-name").all_inner_texts() == ["now", "held"]
    act_and_wait(page, lambda: page.click("#back"))
    np.testing.assert_array_equal(scene_map(page, "reason"), before)


def test_errors_are_shown_with_the_command_line_s_messages(page, server):
    number = page.locator('[data-key="exposure.target"] input[type=number]')
    number.fill("4")
    number.press("Enter")
    page.wait_for_selector("#error:not([hidden])")
    text = page.locator("#error").inner_text()
    assert text == (
        f"{server.session._path}: exposure.target is 4: it should be less than or equal to 1"
    )
    page.locator("#text").fill("parts: [{builtin: nothing}]\n")
    page.click("#apply")
    page.wait_for_function(
        "() => document.getElementById('error').textContent.includes('built-in')"
    )
    assert "no built-in part 'nothing': choose " in page.locator("#error").inner_text()
    failed, now = (page.get_attribute("#main", f"data-{name}") for name in ("failed", "asked"))
    assert failed == now  # Other tests wait for this.
    dimmed = "parseFloat(getComputedStyle(document.querySelector('#picture-side .stage')).opacity)"
    assert page.evaluate(dimmed) < 0.5  # The picture shows other settings than the page.
    act_and_wait(page, lambda: page.click("#undo"))
    assert page.locator("#error").is_hidden()
    assert page.evaluate(dimmed) == 1


def test_all_figures_are_visible_in_a_window_of_1500_by_950(page):
    page.set_viewport_size({"width": 1500, "height": 950})
    beside = page.locator("#beside").bounding_box()
    last = page.locator("#figures > :last-child").bounding_box()
    assert last["y"] + last["height"] <= beside["y"] + beside["height"] <= 950
    assert page.get_attribute('[data-toggle="parts"]', "aria-pressed") == "true"


def test_the_page_of_a_cell_that_fails_to_render_has_its_controls(browser, page, server):
    """Even a page that is opened after all others were closed has controls to undo the change."""
    number = page.locator('[data-key="view.distance_m"] input[type=number]')
    number.fill("5")
    act_and_wait(page, lambda: number.press("Enter"), may_fail=True)
    assert page.locator("#error").is_visible()
    page.goto("about:blank")
    deadline = time.monotonic() + 30
    while server.session.pid is not None and time.monotonic() < deadline:
        time.sleep(0.1)
    again = browser.new_page(viewport={"width": 1400, "height": 900})
    again.goto(server.url)
    again.wait_for_selector("#error:not([hidden])", timeout=WAIT_MS)
    assert "the message above says why" in again.locator("#waiting").inner_text()
    number = again.locator('[data-key="view.distance_m"] input[type=number]')
    assert number.input_value() == "5"
    number.fill("900")
    act_and_wait(again, lambda: number.press("Enter"))
    assert again.locator("#waiting").count() == 0
    again.close()


def test_controls_exist_before_the_first_picture(browser, server):
    """In this test, no process makes pictures."""
    server.session.open = lambda: None
    page = browser.new_page()
    page.goto(server.url)
    page.wait_for_selector('[data-key="view.distance_m"] input[type=number]')
    assert page.locator("#waiting").inner_text().startswith("Starting")
    page.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    number = page.locator('[data-key="exposure.target"] input[type=number]')
    number.fill("0.4")
    number.press("Enter")
    page.wait_for_function("() => document.getElementById('text').value.includes('target: 0.4')")
    assert number.input_value() == "0.4"
    page.close()


def test_a_refused_text_remains_in_its_field(page):
    text = page.locator("#text")
    wrong = text.input_value().replace("count: 3", "count: 4\nconut: 3")
    text.fill(wrong)
    page.click("#apply")
    page.wait_for_selector("#error:not([hidden])")
    assert "conut" in page.locator("#error").inner_text()
    assert text.input_value() == wrong
    text.fill(wrong.replace("conut: 3\n", ""))
    act_and_wait(page, lambda: page.click("#apply"))
    assert "count: 4" in text.input_value() and page.locator("#reset").is_hidden()
    text.fill("nothing of use")
    page.click("#reset")
    assert "count: 4" in text.input_value()


def test_the_error_for_a_low_bit_depth_names_a_setting_that_has_a_control(page):
    depth = page.locator('[data-key="sensor.bit_depth"] input[type=number]')
    depth.fill("6")
    depth.press("Enter")
    page.wait_for_selector("#error:not([hidden])")
    assert "lower offset_dn, or raise bit_depth" in page.locator("#error").inner_text()
    offset = page.locator('[data-key="sensor.offset_dn"] input[type=number]')
    offset.fill("4")
    act_and_wait(page, lambda: offset.press("Enter"))
    depth.fill("6")
    act_and_wait(page, lambda: depth.press("Enter"), may_fail=True)
    assert "bit_depth: 6" in page.locator("#text").input_value()


def test_every_view_is_drawn_and_shows_values_under_the_pointer(page):
    assert page.locator('[data-view="p_wrong"]').count() == 0  # The scanner does not estimate it.
    limit = page.locator('[data-key="decode.max_p_wrong"] input[type=number]')
    limit.fill("0.5")
    act_and_wait(page, lambda: limit.press("Enter"))
    pictures = set()
    for view in page.evaluate("Graycast.VIEWS.map((view) => view.id)"):
        page.click(f'[data-view="{view}"]')
        data = page.evaluate("document.getElementById('picture').toDataURL()")
        pictures.add(data)
    assert len(pictures) == len(page.evaluate("Graycast.VIEWS"))
    page.click('[data-view="pattern"]')
    act_and_wait(page, lambda: page.select_option("#choose-frame", "5"))
    assert page.evaluate("Graycast.opened().header.frame") == 5
    box = page.locator("#picture").bounding_box()
    page.mouse.move(box["x"] + 80.5 * box["width"] / 160, box["y"] + 60.5 * box["height"] / 120)
    i = 60 * 160 + 80
    step = page.evaluate(f"Graycast.opened().scene.depth[{i}]")
    scale_mm = page.evaluate("Graycast.opened().scene.depth_scale_mm")
    text = page.locator('#readout tr[data-name="perfect"] td').first.inner_text()
    assert text == f"{step * scale_mm:.2f} mm"


def resident(pid):
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def test_100_random_actions_cause_no_error_and_no_leak(page, server):
    """The configuration may be refused: a bin can be too small for its parts."""
    rng = random.Random(3)
    listed = [one for one in controls(page) if "choices" not in one and one["cost"] != "physics"]
    listed = [one for one in listed if not one["key"].startswith("render.")]
    pid, memory = server.session.pid, []
    for move in range(MOVES):
        control = rng.choice(listed)
        low, high, step = control["low"], control["high"], control.get("step")
        value = low * (high / low) ** rng.random() if step is None else rng.uniform(low, high)
        if step is not None:
            value = low + round((value - low) / step) * step
        field(page, control).evaluate(
            "(e, v) => { e.value = v; e.dispatchEvent(new Event('change')); }",
            f"{value * control.get('scale', 1):.6g}",
        )
        page.wait_for_timeout(rng.choice((0, 20, 150)))
        if move % 10 == 9:
            page.click("#undo")
        if move % 25 == 24:
            page.click('[data-look="top"]')
            act_and_wait(page, lambda: page.click("#undo"), may_fail=True)
            memory.append(resident(pid))
    assert server.session.pid == pid  # The process was never restarted.
    errors = page.evaluate("Graycast.live.errors")
    assert not [text for text in errors if "error in Graycast" in text or "was ended" in text]
    assert memory[-1] - memory[1] < 150e6, memory
    page.goto("about:blank")
    deadline = time.monotonic() + 30
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.1)  # The session forgets the process before it ends.
    assert server.session.pid is None and not Path(f"/proc/{pid}").exists()
    page.goto(server.url)  # The page keeps its settings, and shows a picture or an error.
    page.wait_for_function(
        "() => document.getElementById('main').dataset.shown !== undefined "
        "|| !document.getElementById('error').hidden",
        timeout=WAIT_MS,
    )
