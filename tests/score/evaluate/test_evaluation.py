"""The command graycast detector score: its files, and a one-line error for each wrong input."""

import csv
import json

import numpy as np
import pytest
from drawn import no_pixels

from graycast.cli import main
from graycast.dataset.export import Split
from graycast.dataset.read.detections import Detections, read_results, results_bytes
from graycast.dataset.training import open_examples
from graycast.score.evaluate import Protocol, Task, evaluate, evaluation_json, summary
from graycast.score.evaluate.labels import run_lengths_of

# An array type of pycocotools 2.0.11 is older than NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SCENES = (0, 3, 4, 5)


def perfect(dataset, scene_ids=SCENES, masked=True):
    """Return the truth as detections, with a higher score for a more visible instance."""
    detections = []
    for scene_id in scene_ids:
        example = open_examples(dataset).read(scene_id)
        order = np.argsort(-example.visib_fract, kind="stable")
        detections.append(
            Detections(
                scene_id=scene_id,
                score=(0.5 + 0.49 * example.visib_fract[order]).astype(np.float32),
                obj_id=example.obj_id[order],
                box_px=example.box_px[order].copy(),
                mask=tuple(run_lengths_of(example.mask[order])) if masked else None,
            )
        )
    return detections


@pytest.fixture
def results(master, tmp_path):
    path = tmp_path / "results.json"
    path.write_bytes(results_bytes(perfect(master)))
    return path


def written_run(folder, detections, **fields):
    folder.mkdir()
    (folder / "results.json").write_bytes(results_bytes(detections))
    record = {
        "scene_ids": [one.scene_id for one in detections],
        "split": "train",
        "division": None,
        "model": "by hand",
        "input": "rgb",
        "ms_per_picture": [4.0] * len(detections),
    }
    (folder / "detect.json").write_text(json.dumps(record | fields))
    return folder


def evaluated(*arguments):
    return main(["detector", "score", *map(str, arguments)])


def evaluation_of(results, on, **options):
    """Return an evaluation without its files, whose plots take most of the command's time."""
    task = Task(results=results, dataset=on, protocol=Protocol(draws=20), **options)
    return evaluate(task)[0]


def refusal(capsys, *arguments):
    capsys.readouterr()
    assert evaluated(*arguments) == 1
    text = capsys.readouterr().err
    assert text.startswith("graycast: error: ") and text.count("\n") == 1
    return text


@pytest.mark.slow
def test_true_labels_as_detections_score_one_in_every_file(master, results, tmp_path, capsys):
    out = tmp_path / "out"
    with no_pixels():
        assert evaluated(results, "--on", master, "--out", out, "--resamples", 50) == 0
    assert "box   AP 1.000 (1.000 to 1.000)" in capsys.readouterr().out
    assert {file.name for file in out.iterdir()} == {
        "evaluation.json",
        "figures.csv",
        "figures.md",
        "groups.png",
        "precision_recall.png",
    }  # fmt: skip - There are no sheets, because nothing is missed and nothing is false.
    record = json.loads((out / "evaluation.json").read_bytes())
    for kind in ("box", "mask"):
        first = record["kinds"][kind]["figures"][0]
        assert first["by"] == "all"
        for name in ("ap", "ap50", "ap75", "ar"):
            assert first[name] == {"value": 1.0, "low": 1.0, "high": 1.0}
        assert record["kinds"][kind]["working_point"]["missed"] == 0
    assert record["instances"] - record["ignored"] == first["to_find"]
    with (out / "figures.csv").open() as file:
        rows = list(csv.DictReader(file))
    known = [row for row in rows if row["value"]]
    assert known and all(float(row["value"]) == 1.0 for row in known)
    by_visibility = [r for r in rows if r["by"] == "visibility" and r["figure"] == "ap"]
    assert sum(int(r["to_find"]) for r in by_visibility) == 2 * first["to_find"]  # boxes and masks


@pytest.mark.slow
def test_missed_parts_and_false_alarms_are_drawn_on_sheets_and_counted(master, tmp_path):
    detections = perfect(master)
    one = detections[0]
    moved = one.box_px + np.array([[40, 0, 0, 0]], np.float32)
    odd = Detections(scene_id=0, score=one.score, obj_id=one.obj_id, box_px=moved)
    rest = [
        Detections(scene_id=f.scene_id, score=f.score, obj_id=f.obj_id, box_px=f.box_px)
        for f in detections[1:]
    ]
    path = tmp_path / "results.json"
    path.write_bytes(results_bytes([odd, *rest]))
    out = tmp_path / "out"
    assert evaluated(path, "--on", master, "--out", out, "--resamples", 20) == 0
    assert {"misses_box.png", "false_alarms_box.png"} <= {file.name for file in out.iterdir()}
    kinds = json.loads((out / "evaluation.json").read_bytes())["kinds"]
    assert list(kinds) == ["box"]  # The results have no masks.
    scenes = {scene["scene_id"]: scene for scene in kinds["box"]["scenes"]}
    assert scenes[0]["missed"] > 0 and scenes[0]["false"] > 0
    assert scenes[3] == {
        "scene_id": 3, "found": scenes[3]["found"], "missed": 0, "false": 0
    }  # fmt: skip
    assert sum(kinds["box"]["working_point"]["false_alarms"].values()) == scenes[0]["false"]


@pytest.mark.slow
def test_the_scenes_of_a_run_are_judged_with_its_division_into_sets(master, tmp_path):
    whole = open_examples(master)
    division = Split(shares=(0.5, 0.0, 0.5), seed=1)
    test = open_examples(master, split="test", division=division).scene_ids
    assert 0 < len(test) < len(whole)
    fields = {"split": "test", "division": {"shares": [0.5, 0.0, 0.5], "seed": 1}}
    run = written_run(tmp_path / "run", perfect(master, test), **fields)
    record = evaluation_json(evaluation_of(run, master))
    assert record["scene_ids"] == list(test)
    assert record["model"] == "by hand"
    assert record["median_ms_per_picture"] == 4.0


@pytest.mark.slow
def test_an_export_has_the_scores_of_its_dataset(master, exported, tmp_path):
    fewer = tmp_path / "results.json"
    fewer.write_bytes(results_bytes(perfect(master, SCENES[:3])))
    own, export = (evaluation_of(fewer, on, kind="mask") for on in (master, exported("coco")))
    assert 0 < own.judgements[0].scores.ap < 1
    assert own.judgements[0].rows[0].figures == export.judgements[0].rows[0].figures


@pytest.mark.slow
def test_all_scenes_are_judged_if_a_run_has_all_sets_of_an_export(master, exported, tmp_path):
    export = exported("coco", split=Split(shares=(0.5, 0.0, 0.5), seed=1))
    run = written_run(tmp_path / "run", perfect(master), split=None)
    record = evaluation_json(evaluation_of(run, export))
    assert record["scene_ids"] == list(SCENES)
    assert sorted(record["split"].split(", ")) == ["test", "train"]
    assert record["kinds"]["mask"]["figures"][0]["ap"]["value"] == 1.0


@pytest.mark.slow
def test_equal_results_differ_by_zero_and_swapped_classes_score_zero(master, results, tmp_path):
    swapped = json.loads(results.read_bytes())
    for entry in swapped:
        entry["category_id"] = 3 - entry["category_id"]  # The dataset's parts are 1 and 2.
    other = tmp_path / "swapped.json"
    other.write_text(json.dumps(swapped))
    text = summary(evaluation_of(results, master, kind="mask", against=results))
    assert "difference: AP +0.000 (+0.000 to +0.000)" in text
    assert "AP 0.000" in summary(evaluation_of(other, master, kind="mask"))
    assert "AP 1.000" in summary(evaluation_of(other, master, kind="mask", one_class=True))
    gap = evaluation_of(results, master, kind="mask", against=other).judgements[0].against
    assert gap["ap"].value == gap["ap"].low == gap["ap"].high == 1.0


def test_no_detections_score_zero_and_not_nan(master, tmp_path):
    path = tmp_path / "results.json"
    path.write_bytes(results_bytes([]))
    text = summary(evaluation_of(path, master))
    assert "AP 0.000 (0.000 to 0.000)" in text
    assert "nothing was found in 4" in text


def entry(**changed):
    return {"image_id": 0, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 0.5} | changed


RUNS = {"size": [120, 160], "counts": "0"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[{", "is not JSON, or is cut off"),
        ("{}", "is not a JSON list: give a file of COCO results"),
        ([entry(image_id=99)], "entry 0 is of image 99"),
        ([entry(), entry(category_id=7)], "entry 1 is of category 7, and the dataset has 1, 2"),
        ([entry(score=float("nan"))], "score is nan; it must be a finite number"),
        ([entry(score="high")], "score is 'high'; it must be a finite number"),
        ([entry(bbox=[1, 2, 3])], "bbox is [1, 2, 3]; it must be four finite numbers"),
        ([entry(bbox=[9, 9, -3, 4])], "must not be negative: give x, y, width, height"),
        ([entry(image_id="0")], "image_id is '0'; it must be a whole number"),
        ([{"image_id": 0, "score": 1}], "lacks one of image_id, category_id, score"),
        ([{"image_id": 0, "category_id": 1, "score": 1}], "has neither bbox nor segmentation"),
        ([entry(), entry(segmentation=RUNS)], "run lengths do not fill 160 x 120 pixels"),
        ([entry(segmentation=[[0, 0, 1, 1]])], "segmentation is not a run-length encoding"),
        ([entry(segmentation={"size": [4, 4], "counts": "o"})], "run lengths do not fill 4 x 4"),
        (
            [entry(segmentation={"size": [4, 4], "counts": [16]})],
            "of 4 x 4 pixels, the picture has",
        ),
        (
            [entry(), entry(segmentation={"size": [4, 4], "counts": [16]})],
            "some entries have a segmentation and others have none",
        ),
    ],
)
def test_results_that_do_not_fit_the_dataset_are_refused_with_the_reason(
    master, tmp_path, capsys, text, words
):
    path, out = tmp_path / "results.json", tmp_path / "out"
    path.write_text(text if isinstance(text, str) else json.dumps(text))
    message = refusal(capsys, path, "--on", master, "--out", out)
    assert words in message
    assert not out.exists()


def test_a_run_that_does_not_fit_the_dataset_is_refused(master, tmp_path, capsys):
    out = tmp_path / "out"
    detections = perfect(master)

    def message_of(run, *more):
        return refusal(capsys, run, "--on", master, "--out", out, *more)

    assert "cannot be read" in message_of(tmp_path / "none.json")
    (tmp_path / "empty").mkdir()
    assert "has no results.json" in message_of(tmp_path / "empty")
    bare = written_run(tmp_path / "bare", detections)
    (bare / "detect.json").unlink()
    assert "has no detect.json" in message_of(bare)
    (bare / "detect.json").write_text("{}")
    assert "lacks 'division': run graycast detector find again" in message_of(bare)
    (bare / "detect.json").write_text('{"division": null, "scene_ids": ["x"]}')
    assert "is damaged ('x' is not a whole number)" in message_of(bare)
    elsewhere = written_run(tmp_path / "elsewhere", detections, scene_ids=[*SCENES, 50])
    assert "has detections in scene 50" in message_of(elsewhere)
    fewer = written_run(tmp_path / "fewer", detections[:2])
    assert "scene 4 was not used" in message_of(bare.parent / "fewer", "--split", "train")
    assert "scene 4 was not used" in message_of(
        written_run(tmp_path / "run", detections), "--against", fewer
    )
    boxes = written_run(tmp_path / "boxes", perfect(master, masked=False))
    assert "detections have no masks" in message_of(boxes, "--kind", "mask")
    assert "has no set 'test'" in message_of(boxes, "--split", "test")
    assert "--split-seed applies only with --shares" in message_of(boxes, "--split-seed", "3")
    assert "min_visibility is 1.0" in message_of(boxes, "--min-visibility", "1")
    assert not out.exists()
    assert "holds poses: use graycast robot score-poses" in message_of(tmp_path / "poses.csv")
    assert "not a Graycast dataset" in refusal(capsys, boxes, "--on", tmp_path, "--out", out)
    (out / "mine").mkdir(parents=True)
    assert "holds no earlier result of this command" in message_of(boxes)


def test_written_results_are_read_back_to_the_last_bit(tmp_path):
    """Scores and edges in single precision are written with enough digits to distinguish them."""
    rng = np.random.default_rng(0)
    score = np.sort(rng.random(200, np.float32))[::-1].copy()
    detections = Detections(
        scene_id=7,
        score=score,
        obj_id=rng.integers(1, 5, 200),
        box_px=(rng.random((200, 4)) * 500).astype(np.float32),
        mask=tuple(run_lengths_of(rng.random((200, 9, 11)) < 0.5)),
    )
    path = tmp_path / "results.json"
    path.write_bytes(results_bytes([detections]))
    (read,) = read_results(path, [7])
    assert (read.score.astype(np.float32) == detections.score).all()
    assert (read.box_px.astype(np.float32) == detections.box_px).all()
    assert (read.obj_id == detections.obj_id).all()
    assert list(read.mask) == list(detections.mask)


def test_uncompressed_masks_without_boxes_are_read(tmp_path):
    mask = np.zeros((1, 6, 5), bool)
    mask[0, 2:5, 1:4] = True
    counts = [8, 3, 3, 3, 3, 3, 7]  # run lengths down the columns, counted by hand
    runs = {"size": [6, 5], "counts": counts}
    path = tmp_path / "results.json"
    path.write_text(
        json.dumps([{"image_id": 0, "category_id": 1, "score": 1, "segmentation": runs}])
    )
    (detections,) = read_results(path, [0])
    assert list(detections.mask) == list(run_lengths_of(mask))
    assert detections.box_px.tolist() == [[1, 2, 3, 3]]
