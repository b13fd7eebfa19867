"""Actions of a user on the page, and readers of the page's content, for tests with a browser."""

from contextlib import contextmanager

import numpy as np

SCENES = (0, 3, 4)


def ready(page, name):
    page.wait_for_selector(f'#main[data-ready="{name}"]')


@contextmanager
def watched_page(browser, address):
    """Open the overview; at the end, any message of the browser fails the test."""
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
    page.goto(address)
    ready(page, "overview")
    yield page
    page.close()
    assert complaints == []


def opened(page, report, scene_id, view=None):
    page.goto(f"{report[2].as_uri()}#/train-{scene_id:06d}")
    ready(page, f"train-{scene_id:06d}")
    if view:
        page.click(f'[data-view="{view}"]')


def pressed(page):
    """Return the id of the active view."""
    return page.get_attribute('[data-view][aria-pressed="true"]', "data-view")


def scene_map(page, name):
    return np.array(page.evaluate(f"Array.from(Graycast.opened().scene.{name})")).reshape(120, 160)


def canvas_pixels(page, canvas="picture"):
    """Return a canvas's pixels from a copy, because browsers warn if a canvas is read often."""
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
    """Return the position on the screen of a pixel of the picture."""
    box = page.locator("#picture").bounding_box()
    return (
        box["x"] + (column + 0.5) * box["width"] / 160,
        box["y"] + (row + 0.5) * box["height"] / 120,
    )


def readout(page, name):
    return page.locator(f'#readout tr[data-name="{name}"] td').inner_text()
