"""The pictures of docs/how-to/report.md and docs/how-to/live.md: small pictures of pages.

python -m studies.pictures report out/demo_page    the page of the report of docs/how-to/report.md
python -m studies.pictures replay out/picks        the picks of docs/how-to/report.md
python -m studies.pictures live                    graycast live configs/demo.yaml

Each command writes its pictures of docs/images. Playwright and Chromium are needed, as for the
tests of the pages.
"""

import argparse
import io
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from graycast.show.live import serve

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT_MS = 180_000
REPORT_PX, LIVE_PX = (1320, 830), (1440, 900)
ATTEMPT, AFTER_GRIP_S = "bin-000000/3", 0.45
FILM_PX, FRAME_MS = 760, 900
REPLAY_PX, REPLAY_MS, STEP_S = 420, 200, 0.4  # The film is twice as fast as the robot.


@contextmanager
def opened(url: str, size_px: tuple[int, int]) -> Iterator[Page]:
    """Open a page in Chromium, in a window of the given size and with light colours."""
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        width, height = size_px
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme="light")
        page.goto(url)
        yield page


def shot(page: Page) -> Image.Image:
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def save(page: Page, name: str) -> None:
    page.wait_for_timeout(1500)
    shot(page).save(IMAGES / f"{name}.jpg", quality=82, progressive=True)


def press(page: Page, *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)
        page.wait_for_timeout(150)


def seek(page: Page, time_s: str) -> None:
    """Set the time of a replay (a JavaScript expression), and wait until its picture is drawn."""
    page.evaluate(f"""async () => {{
        const slider = document.getElementById("time");
        slider.value = {time_s};
        slider.dispatchEvent(new Event("input"));
        for (let k = 0; k < 2; k++) await new Promise(requestAnimationFrame);
    }}""")


def save_film(frames: list[Image.Image], name: str, width_px: int, frame_ms: int) -> None:
    height_px = round(width_px * frames[0].height / frames[0].width)
    small = [one.resize((width_px, height_px)).quantize(96) for one in frames]
    file, more = IMAGES / f"{name}.gif", small[1:]
    small[0].save(file, save_all=True, append_images=more, duration=frame_ms, loop=0)


def report(folder: Path) -> None:
    with opened((folder / "index.html").resolve().as_uri(), REPORT_PX) as page:
        page.wait_for_selector('#main[data-ready="overview"]')
        press(page, "ArrowRight", "x", "ArrowRight", "ArrowRight", "x", "ArrowDown", "x", "g")
        page.keyboard.type("dark")
        press(page, "Enter", "/")
        page.keyboard.type("0-13")
        press(page, "Escape")
        page.evaluate("scrollTo(0, document.getElementById('grid').offsetTop - 40)")
        save(page, "report_grid")
        press(page, "ArrowRight", "Enter", "5", "Shift+Digit6")
        save(page, "report_compare")
        press(page, "c", "9")
        save(page, "report_3d")


def replay(folder: Path) -> None:
    def graycast(*words: object) -> None:
        subprocess.run([sys.executable, "-m", "graycast", *map(str, words)], check=True)

    with tempfile.TemporaryDirectory() as scratch:
        graycast("robot", "report", folder, "--out", Path(scratch) / "page")
        url = f"{(Path(scratch) / 'page' / 'index.html').resolve().as_uri()}#/{ATTEMPT}"
        with opened(url, REPORT_PX) as page:
            page.wait_for_selector(f'#main[data-ready="{ATTEMPT}"]')
            motion = "Graycast.opened().scan.motion"
            seek(page, f"{motion}.time_s[{motion}.grip] + {AFTER_GRIP_S}")
            press(page, "m")
            save(page, "replay")
            press(page, "m")
            save_film(list(attempts(page)), "replay", REPLAY_PX, REPLAY_MS)


def attempts(page: Page) -> Iterator[Image.Image]:
    """Yield pictures of all attempts in the open bin, at equal steps of time."""
    for number in range(page.evaluate("Graycast.opened().bin.attempts.length")):
        key = f"{ATTEMPT.split('/')[0]}/{number}"
        page.evaluate("(key) => { location.hash = `#/${key}`; }", key)
        page.wait_for_selector(f'#main[data-ready="{key}"]')
        end_s = page.evaluate("Graycast.opened().scan.motion.time_s.at(-1)")
        for k in range(int(end_s / STEP_S) + 1):
            seek(page, f"{STEP_S * k}")
            yield Image.open(io.BytesIO(page.locator("#main .hold").screenshot())).convert("RGB")


def live() -> None:
    with tempfile.TemporaryDirectory() as folder:
        cell = shutil.copy(ROOT / "configs" / "demo.yaml", folder)
        with serve(Path(cell), port=0, scene_id=0, device="auto") as server:
            server.session.set("resolution", "small")
            with opened(server.url, LIVE_PX) as page:
                finished(page)
                frames = film(page)
    frames[-1].save(IMAGES / "live.jpg", quality=80)
    save_film(frames, "live", FILM_PX, FRAME_MS)


def film(page: Page) -> list[Image.Image]:
    """Film a change of exposure, then a frozen picture beside it, then a movement of the rig."""
    frames = [shot(page)]
    page.click('[data-view="reasons"]')
    for target in ("0.4", "0.1"):
        turn(page, "exposure.target", target)
        frames.append(shot(page))
    page.click("#hold")
    turn(page, "exposure.target", "0.8")
    frames.append(shot(page))
    for tilt in ("8", "16"):
        turn(page, "view.tilt_deg", tilt)
        frames.append(shot(page))
    return frames


def turn(page: Page, key: str, value: str) -> None:
    number = page.locator(f'[data-key="{key}"] input[type=number]')
    number.fill(value)
    number.press("Enter")
    page.wait_for_timeout(300)
    finished(page)


def finished(page: Page) -> None:
    page.wait_for_function(
        """() => { const d = document.getElementById("main").dataset;
        return d.exact === "true" && d.shown === d.asked; }""",
        timeout=WAIT_MS,
    )
    page.wait_for_timeout(400)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the pictures of pages in docs/images anew.")
    kinds = parser.add_subparsers(required=True)
    for make, words in ((report, "The page's folder."), (replay, "The folder of picks.")):
        one = kinds.add_parser(make.__name__)
        one.add_argument("folder", type=Path, help=words)
        one.set_defaults(make=make)
    kinds.add_parser("live").set_defaults(make=live)
    options = vars(parser.parse_args())
    options.pop("make")(**options)


if __name__ == "__main__":
    main()
