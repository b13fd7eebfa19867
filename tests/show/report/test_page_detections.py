"""A run's detections on the page: the content of the scripts, and the display."""

import json

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.dataset.read.detections import Detections, results_bytes
from graycast.dataset.training import open_examples
from graycast.score.evaluate.labels import run_lengths_of
from graycast.show.report.page import write_report

from .browsing import opened, ready, watched_page

pytestmark = [
    pytest.mark.slow,
    # An array type of pycocotools 2.0.11 is older than NumPy 2, which warns about it.
    pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning"),
]

FALSE_BOX = [2.0, 3.0, 10.0, 12.0]


@pytest.fixture(scope="session")
def run_report(report, tmp_path_factory):
    """Write a page of scenes 0, 3 and 4 with the detections of a run on scenes 0 and 3.

    In scene 0, all instances are found, with scores that fall from 0.9 in steps of 0.1. In scene 3,
    the first instance is missed, and there is a false alarm with the score 0.85.
    """
    dataset = report[0]
    examples = {scene_id: open_examples(dataset).read(scene_id) for scene_id in (0, 3)}
    folder = tmp_path_factory.mktemp("found")
    run = folder / "run"
    run.mkdir()
    detections = [_detections(examples[0], skip=0), _detections(examples[3], skip=1, false=True)]
    (run / "results.json").write_bytes(results_bytes(detections))
    record = {
        "scene_ids": [0, 3],
        "split": "train",
        "division": None,
        "model": "by hand",
        "input": "rgb",
        "ms_per_picture": [5.0, 7.0],
    }
    (run / "detect.json").write_text(json.dumps(record))
    page = write_report(dataset, folder / "page", detections=run).page
    return dataset, examples, page


def _detections(example, *, skip, false=False):
    mask = example.mask[skip:]
    score = 0.9 - 0.1 * np.arange(len(mask))
    box, obj_id = example.box_px[skip:].astype(float), example.obj_id[skip:]
    if false:
        false_mask = np.zeros_like(example.mask[:1])
        x, y, w, h = map(int, FALSE_BOX)
        false_mask[0, y : y + h, x : x + w] = True
        mask, score = np.concatenate([mask, false_mask]), np.append(score, 0.85)
        box, obj_id = np.vstack([box, FALSE_BOX]), np.append(obj_id, obj_id[0])
    order = np.argsort(-score)
    return Detections(
        scene_id=example.scene_id,
        score=score[order],
        obj_id=obj_id[order],
        box_px=box[order],
        mask=tuple(run_lengths_of(mask[order])),
    )


def received(page, name):
    text = (page.parent / "scenes" / name).read_text()
    return json.loads(text.removeprefix("Graycast.receive(").removesuffix(");\n"))


def test_the_script_of_a_scene_contains_the_match_of_each_detection(run_report):
    _, examples, page = run_report
    scene_0 = received(page, "train-000000/detections.js")
    assert {one["state"] for one in scene_0["detections"]} <= {"hit", "ignored"}
    scene_3 = received(page, "train-000003/detections.js")
    wrong = [one for one in scene_3["detections"] if one["state"] == "mistake"]
    assert [(one["box"], one["score"], one["why"]) for one in wrong] == [
        (FALSE_BOX, 0.85, "nothing there")
    ]
    missed = str(examples[3].instance[0])
    assert scene_3["instances"][missed]["found"] is None
    for detection in scene_3["detections"]:
        if detection["state"] == "hit":
            instance = scene_3["instances"][str(detection["instance"])]
            assert instance["found"] == detection["score"]
    assert not (page.parent / "scenes" / "train-000004" / "detections.js").exists()


def test_a_page_without_results_has_no_detections(run_report, tmp_path):
    dataset, _, page = run_report
    again = write_report(dataset, page.parent.parent / "bare").page
    assert '"detections":null' in (again.parent / "index.js").read_text()
    results = page.parent.parent / "run"
    write_report(dataset, tmp_path / "page", detections=results)
    write_report(dataset, tmp_path / "page")
    assert not list((tmp_path / "page").rglob("detections.js"))


def test_results_of_another_dataset_are_refused_before_a_page_is_written(report, tmp_path):
    odd = tmp_path / "results.json"
    odd.write_bytes(b'[{"image_id": 77, "category_id": 1, "bbox": [0, 0, 1, 1], "score": 1}]')
    with pytest.raises(GraycastError, match="entry 0 is of image 77"):
        write_report(report[0], tmp_path / "page", detections=odd)
    assert not (tmp_path / "page").exists()


@pytest.fixture
def page(browser, run_report):
    with watched_page(browser, run_report[2].as_uri()) as page:
        yield page


def cards(page):
    return page.eval_on_selector_all(".card", "all => all.map((card) => card.dataset.key)")


def outlines(page, state):
    return page.locator(f"#found path.{state}, #found rect.{state}").count()


def move(page, slider, score):
    page.evaluate(
        """([id, score]) => {
            const slider = document.getElementById(id);
            slider.value = score;
            slider.dispatchEvent(new Event("input"));
        }""",
        [slider, score],
    )


def test_filters_select_and_show_scenes_with_missed_parts_and_false_alarms(page):
    page.select_option("#pick-found", "missed")
    assert cards(page) == ["train-000003"]
    assert "1 missed" in page.locator(".found-line").inner_text()
    page.click(".card a")
    ready(page, "train-000003")
    assert (outlines(page, "missed"), outlines(page, "hit"), outlines(page, "mistake")) == (1, 0, 0)
    page.keyboard.press("Escape")
    ready(page, "overview")
    page.select_option("#pick-found", "mistake")
    assert cards(page) == ["train-000003"]
    page.click(".card a")
    ready(page, "train-000003")
    assert (outlines(page, "missed"), outlines(page, "hit"), outlines(page, "mistake")) == (0, 0, 1)
    page.keyboard.press("Escape")
    page.select_option("#pick-found", "right")
    assert cards(page) == ["train-000000"]
    page.select_option("#pick-found", "unseen")
    assert cards(page) == ["train-000004"]
    assert page.locator(".told-row .chip").inner_text().startswith("detector not run")


def test_a_higher_score_limit_shows_more_missed_parts_in_the_grid_and_in_a_scene(page, run_report):
    counted = int((run_report[1][0].visib_fract >= 0.1).sum())
    move(page, "least-score", 0.85)
    page.select_option("#pick-found", "missed")
    assert cards(page) == ["train-000000", "train-000003"]
    page.click('.card[data-key="train-000000"] a')
    ready(page, "train-000000")
    page.select_option("#choose-foundKind", "all")
    assert outlines(page, "hit") == 1  # Only the outline with the score 0.9 is drawn.
    assert outlines(page, "missed") == counted - 1
    move(page, "score-slider", 0)
    assert outlines(page, "missed") == 0
    assert outlines(page, "hit") == counted
    assert page.locator('#found-table tr[data-state="hit"]').count() == counted


def test_a_false_alarm_is_drawn_at_its_position(page, run_report):
    """Oracle: the position of the box's pixels on the screen, from the position of the picture."""
    opened(page, run_report, 3)
    box = page.locator("#picture").bounding_box()
    outline = page.locator("#found path.mistake").bounding_box()
    scale = box["width"] / 160
    x, y, w, h = FALSE_BOX
    assert outline["x"] == pytest.approx(box["x"] + x * scale, abs=scale)
    assert outline["y"] == pytest.approx(box["y"] + y * scale, abs=scale)
    assert outline["width"] == pytest.approx(w * scale, abs=1.5 * scale)
    assert outline["height"] == pytest.approx(h * scale, abs=1.5 * scale)
    page.keyboard.press("d")
    assert page.locator("#found > *").count() == 0
    page.keyboard.press("d")
    assert page.locator("#found > *").count() > 0


def test_a_scene_outside_the_run_is_marked_as_outside(page, run_report):
    opened(page, run_report, 4)
    assert "was not run on this scene" in page.locator("#found-list").inner_text()
    assert page.locator("#toggle-found").count() == 0
