"""The page of picks in a real browser, opened from the disk."""

import cv2
import numpy as np
import pytest

from graycast.robot.pick import read_episodes
from graycast.robot.pick.results.replay import open_replay, read_motions
from graycast.show.report.picks import write_pick_report

from .browsing import ready, watched_page
from .picked import GRIP, LOST_S, STEP_S, STEPS, T_world_part, write_picks

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def picks(robots, tmp_path_factory):
    folder = tmp_path_factory.mktemp("picks")
    return write_picks(folder)[0]


@pytest.fixture(scope="module")
def address(picks, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "page"
    return write_pick_report(picks, out, cell_folder=picks.parent).page.as_uri()


@pytest.fixture
def page(browser, address):
    """Open the list of bins; at the end, any message of the browser fails the test."""
    with watched_page(browser, address) as page:
        yield page


def opened(page, address, key):
    page.goto(f"{address}#/{key}")
    ready(page, key)


def at(page, time_s):
    page.evaluate(
        """(t) => {
            const slider = document.getElementById("time");
            slider.value = t;
            slider.dispatchEvent(new Event("input"));
        }""",
        time_s,
    )


def matrices(page, script):
    """Return the browser's column-major matrices [mm] as poses [m]."""
    values = page.evaluate(f"({script}).map((m) => Array.from(m))")
    T = np.array(values, dtype=float).reshape(-1, 4, 4).transpose(0, 2, 1)
    T[:, :3, 3] *= 1e-3
    return T


def test_the_browser_and_python_give_the_robot_links_the_same_poses(page, address, picks):
    """Oracle: the robot's kinematics; between two times, the mean of both poses."""
    replay = open_replay(picks, folder=picks.parent)
    motions = read_motions(replay, read_episodes(picks)[1])
    opened(page, address, "bin-000002/0")
    motion = "Graycast.opened().scan.motion"
    for i in (0, GRIP, GRIP + 7, STEPS - 1):
        limbs = matrices(page, f"Graycast.limbsAt({motion}, {STEP_S * i + 1e-9})")
        np.testing.assert_allclose(limbs, motions[0].T_world_limb[i], atol=2e-5)
    between = matrices(page, f"Graycast.limbsAt({motion}, {STEP_S * 7.5})")
    middle = motions[0].T_world_limb[[7, 8], :, :3, 3].mean(axis=0)
    np.testing.assert_allclose(between[:, :3, 3], middle, atol=1e-5)
    turn = between[:, :3, :3]
    np.testing.assert_allclose(turn @ turn.transpose(0, 2, 1) - np.eye(3), 0, atol=1e-5)


def test_the_part_moves_with_the_tool_until_its_release(page, address, picks):
    """Oracle: `T_world_part`; after its loss, a part is at its pose in the next scan."""
    replay = open_replay(picks, folder=picks.parent)
    episode = read_episodes(picks)[0]
    motion = read_motions(replay, episode)[1]
    before = np.array(episode.attempts[1]["T_world_part"][0])
    opened(page, address, "bin-000000/1")
    part = "Graycast.opened().content.attempts[1].parts[0]"
    for i in range(0, STEPS, 3):  # No step is exactly at the time of the release.
        time_s = STEP_S * i
        script = f"Graycast.carried(Graycast.opened().scan.motion, {time_s + 1e-9}, {part})"
        expected = T_world_part(motion, i, before)
        if i < GRIP or time_s > STEP_S * GRIP + LOST_S:
            assert expected is None and page.evaluate(f"{script} === null")
        else:
            np.testing.assert_allclose(matrices(page, f"[{script}]")[0], expected, atol=5e-5)
    fell = matrices(
        page,
        "[Graycast.resting({...Graycast.opened(), attempt: Graycast.opened().content.attempts[1],"
        " motion: Graycast.opened().scan.motion, time: 2}, 0)]",
    )[0]
    np.testing.assert_allclose(fell, episode.attempts[2]["T_world_part"][0], atol=1e-5)


def test_the_scan_on_the_page_equals_the_stored_depth(page, address, picks):
    for number in range(3):
        opened(page, address, f"bin-000000/{number}")
        scan = np.array(page.evaluate("Array.from(Graycast.opened().scan.scanner)"))
        stored = cv2.imread(
            str(picks / f"bins/000000/depth/{number:03d}.png"), cv2.IMREAD_UNCHANGED
        )
        np.testing.assert_array_equal(scan.reshape(stored.shape), stored)


def test_points_of_the_scan_are_on_the_true_parts(page, address, picks):
    """Law: the scan shows these parts, so all its points above the floor are on them."""
    opened(page, address, "bin-000000/0")
    points = page.evaluate(
        """() => {
            const { scan } = Graycast.opened(), at = Graycast.shapes.pointOf(scan), out = [];
            for (let i = 0; i < scan.n; i++) if (scan.scanner[i]) out.push(at(i, scan.scanner[i]));
            return out;
        }"""
    )
    points = 1e-3 * np.array(points)
    inside = (np.abs(points[:, :2]) < [0.124, 0.099]).all(axis=1)
    lay = np.array(read_episodes(picks)[0].attempts[0]["T_world_part"])
    raised = points[inside & (points[:, 2] > 2e-3)]
    half = np.array([0.03, 0.02, 0.015]) + 3e-4
    on_any = np.zeros(len(raised), bool)
    for T in lay:
        local = (raised - T[:3, 3]) @ T[:3, :3]
        on_any |= (np.abs(local) < half).all(axis=1)
    assert len(raised) > 100 and on_any.all()


def test_the_3d_view_draws_the_selected_layers(page, address):
    def picture():
        page.wait_for_timeout(400)
        data = page.locator("#cloud").screenshot()
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(int)

    opened(page, address, "bin-000000/0")
    at(page, STEP_S * GRIP)
    pictures = [picture()]
    for key in "rpbm":
        page.keyboard.press(key)
        pictures.append(picture())
        assert (np.abs(pictures[-1] - pictures[-2]).max(axis=2) > 20).mean() > 5e-4, key
    before = picture()
    at(page, 0)
    assert np.abs(picture() - before).max() <= 2  # The robot is hidden; the part is not lifted yet.
    page.keyboard.press("r")
    here = picture()
    at(page, 1)
    assert (np.abs(picture() - here).max(axis=2) > 20).mean() > 5e-3  # The arm has moved.


def test_the_play_button_shows_all_attempts(page, address):
    opened(page, address, "bin-000000/0")
    page.select_option("#speed", "8")
    page.keyboard.press("Space")
    page.wait_for_function("Graycast.opened().number === 2", timeout=30_000)
    assert page.locator("#ended h1").inner_text() == "nothing found"
    assert page.locator(".under").inner_text() == "The arm does not move."


def test_attempts_are_listed_and_filtered_by_outcome(page, address):
    assert page.locator(".facts").inner_text().count("50.0 %") == 1
    rows = page.eval_on_selector_all(
        "#outcomes tr", "all => all.map((r) => [r.dataset.outcome, r.children[1].textContent])"
    )
    assert dict(rows) == {"picked": "2", "lost seal": "2", "nothing found": "2"}
    page.click('[data-outcome="lost seal"].outcome')
    assert page.locator(".strip a:not(.dim)").count() == 2
    page.click('[data-bin="bin-000002"] .open')
    ready(page, "bin-000002")
    assert page.locator("#ended h1").inner_text() == "lost seal"  # the first selected attempt
    assert page.locator(".attempt").count() == 1
    page.keyboard.press("Escape")
    ready(page, "overview")
    page.click("#reset")
    page.locator('[data-bin="bin-000000"] .strip a').nth(2).click()
    ready(page, "bin-000000/2")
    assert page.locator(".attempt").count() == 3


def test_the_description_changes_with_the_time_of_the_attempt(page, address):
    opened(page, address, "bin-000000/0")
    page.keyboard.press("ArrowRight")
    ready(page, "bin-000000/1")
    assert "after 0.40 s" in page.locator("#ended").inner_text()
    under = page.locator(".under")
    grip_s = STEP_S * GRIP
    for time_s, text in (
        (0.0, "The tool moves to its grip."),
        (grip_s + LOST_S / 2, "The tool carries the part."),
        (grip_s + LOST_S + 0.1, "The part is released: lost seal."),
    ):
        at(page, time_s)
        assert under.inner_text() == text
    page.keyboard.press("ArrowDown")
    ready(page, "bin-000002")


def test_a_missing_bin_is_reported(page, address):
    for key, text in (("bin-000007", "no bin-000007"), ("bin-000000/9", "3 attempts")):
        opened(page, address, key)
        assert text in page.locator(".sorry").inner_text()


def test_no_two_rows_in_the_table_of_seconds_have_the_same_name(page):
    """The scanner's time and the computing time of a scan are different rows."""
    names = page.locator("#stages th").all_inner_texts()
    assert len(names) >= 3 and len(names) == len(set(names))


@pytest.mark.parametrize("size", [(1280, 800), (1024, 768)])
def test_all_bins_fill_the_window(page, size):
    """Law: the bins' cards are next to each other, with pictures, and fill the window."""
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.wait_for_function(
        "[...document.querySelectorAll('.bin img')].every((i) => i.naturalWidth === 160)"
    )
    tables = [page.locator(name).bounding_box() for name in ("#outcomes", "#stages")]
    assert tables[0]["x"] + tables[0]["width"] < tables[1]["x"]
    cards = [page.locator(".bin").nth(k).bounding_box() for k in range(2)]
    assert cards[0]["y"] == cards[1]["y"]
    low, right = (cards[1][a] + cards[1][b] for a, b in (("y", "height"), ("x", "width")))
    assert 0.95 * size[1] < low <= size[1] and 0.95 * size[0] < right < size[0]
