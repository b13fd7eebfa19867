"""Test studies: each combination runs once, and the tables contain the evaluated scores."""

import csv
import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from learn.detect.drawn import write_shapes

from graycast.base.errors import GraycastError
from graycast.cli import main
from graycast.dataset.export.split import Split
from graycast.dataset.read.detections import Detections, read_results
from graycast.dataset.training import open_examples
from graycast.learn import study_file
from graycast.learn.detect import Detector
from graycast.learn.detect.detecting import PictureSelection
from graycast.learn.study import Result, StudyRun, run_study, runs_of, study_runs, write_study
from graycast.learn.study_file import EncodingSection, ModelSection, StudySpec, read_study
from graycast.score.evaluate import labels_of, score
from graycast.score.evaluate.intervals import BootstrapFigure, mean
from graycast.score.evaluate.labels import run_lengths_of

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

STUDY = {
    "title": "Drawn_things",
    "models": [{"model": "yolov3", "backbone": "mobilenet-v3-small"}],
    "inputs": ["rgb", "depth_sl"],
    "training": {"drawn": ["own"]},
    "tests": {
        "own": {"datasets": ["own"], "split": "test"},
        "other": {"datasets": ["other"]},
    },
    "gap": ["own", "other"],
    "split": [0.5, 0.2, 0.3],
    "epochs": 2,
    "longest_px": 128,
    "batch": 2,
}


def written(folder, **changed):
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(STUDY | changed))
    return path


def test_every_combination_occurs_once(tmp_path):
    encodings = [{"name": "channel"}, {"name": "zero", "holes": "zero"}]
    spec = read_study(written(tmp_path, encodings=encodings, seeds=[0, 1]))
    names = [run.name for run in runs_of(spec)]
    assert len(names) == len(set(names)) == 2 * 1 + 2 * 2  # colour has one encoding
    assert spec.training["drawn"] == (tmp_path / "own",)
    other = {"model": "mask-rcnn", "seeds": [7]}
    spec = read_study(written(tmp_path, models=[*STUDY["models"], other], seeds=[0, 1]))
    seeds = [(run.model.model, run.seed) for run in runs_of(spec) if run.input == "rgb"]
    assert seeds == [("yolov3", 0), ("yolov3", 1), ("mask-rcnn", 7)]


def first_row(folder):
    text = (folder / "table.csv").read_text()
    return next(csv.DictReader(io.StringIO(text)))


def normal(value, sigma, seed):
    draws = np.random.default_rng(seed).normal(value, sigma, 4000)
    return BootstrapFigure(value=value, draws=draws, scenes=1000)


def test_the_variance_of_a_difference_is_the_sum_of_the_two_variances(tmp_path):
    """Oracle: 0.03 and 0.04 make 0.05; the interval of a normal figure is 1.96 of it either way."""
    run = StudyRun(
        model=ModelSection(model="yolov3"),
        input="rgb",
        encoding=EncodingSection(name="default"),
        training="drawn",
        seed=0,
    )
    figures = {
        ("own", "box"): (normal(0.8, 0.03, 1),),
        ("other", "box"): (normal(0.6, 0.04, 2),),
    }
    spec = StudySpec.model_validate(STUDY)
    write_study(spec, [Result(run=run, figures=figures)], tmp_path)
    row = first_row(tmp_path)
    assert float(row["gap"]) == pytest.approx(0.2)
    half = (float(row["gap_high"]) - float(row["gap_low"])) / 2
    assert half == pytest.approx(1.96 * 0.05, rel=0.05)
    assert "| yolov3 | rgb | box | 0.80 [0.74, 0.86]" in (tmp_path / "table.md").read_text()
    assert r"Drawn_things: AP50" in (tmp_path / "table.tex").read_text()
    assert json.loads((tmp_path / "study.json").read_text())["rows"][0]["own"] == 0.8


def test_each_dataset_of_a_world_has_its_own_row_in_the_table(tmp_path):
    run = StudyRun(
        model=ModelSection(model="yolov3"), input="rgb",
        encoding=EncodingSection(name="default"), training="drawn", seed=0,
    )  # fmt: skip
    figures = {
        ("own", "box"): (normal(0.9, 0.03, 1), normal(0.7, 0.03, 2)),
        ("other", "box"): (normal(0.5, 0.04, 3), normal(0.6, 0.04, 4)),
    }
    worlds = {"own": {"datasets": ["nut", "bolt"]}, "other": {"datasets": ["a", "b"]}}
    spec = StudySpec.model_validate(STUDY | {"tests": worlds})
    write_study(spec, [Result(run=run, figures=figures)], tmp_path)
    rows = json.loads((tmp_path / "study.json").read_text())["rows"]
    assert [row["dataset"] for row in rows] == ["all", "nut", "bolt"]
    assert [row["own"] for row in rows] == pytest.approx([0.8, 0.9, 0.7])
    assert [row["gap"] for row in rows] == pytest.approx([0.25, 0.4, 0.1])
    table = (tmp_path / "table.md").read_text()
    assert table.index("| bolt | 0.70 [") > table.index("## Each dataset by itself")
    assert "0.80 [" in table[: table.index("## Each")]


def test_the_mean_over_sets_has_a_smaller_error_than_each_set():
    """Oracle: four independent figures of one spread have half of it in their mean."""
    four = mean([normal(0.5, 0.04, seed) for seed in range(4)]).interval
    assert four.value == pytest.approx(0.5)
    assert (four.high - four.low) / 2 == pytest.approx(1.96 * 0.02, rel=0.06)


def test_a_changed_detector_or_dataset_repeats_the_detection(tmp_path, monkeypatch):
    """A dataset replaced in its folder was once scored with detections in the old one."""
    world = study_file.TestSection(datasets=(tmp_path,))
    folder, calls = tmp_path / "found", []
    detector = object.__new__(Detector)
    object.__setattr__(detector, "about", None)
    content = {"content": ["a"]}

    def pictures(dataset, about, **_):
        return PictureSelection(
            examples=(), scene_ids=(0,), class_ids={}, record={"dataset": "own", **content}
        )

    def find(detector, selection, out, **_):
        calls.append(out)
        out.mkdir(exist_ok=True)
        record = {"scene_ids": [0], **selection.record}
        (out / "detect.json").write_text(json.dumps(record))

    monkeypatch.setattr(study_runs, "pictures_of", pictures)
    monkeypatch.setattr(study_runs, "detect", find)
    monkeypatch.setattr(study_runs, "read_results", lambda *_: [])
    (tmp_path / "detector.pt").write_bytes(b"one")

    def number():
        study_runs._detections(detector, tmp_path, world, folder)
        return len(calls)

    assert (number(), number()) == (1, 1)
    content["content"] = ["b"]
    assert (number(), number()) == (2, 2)
    (tmp_path / "detector.pt").write_bytes(b"two")
    assert (number(), number()) == (3, 3)


def boxes_alone(folder, name):
    """Write a set as other programs do: COCO annotations without masks, and only colour."""
    write_shapes(folder / name, 4)
    path = folder / name / "source" / "annotations" / "drawn.json"
    content = json.loads(path.read_text())
    for entry in content["annotations"]:
        del entry["segmentation"]
    path.write_text(json.dumps(content))
    return str(path)


def true_detections(detector, dataset, world, folder):
    """Return the detections of a perfect mask detector: true masks, or rectangles without them."""
    detections = []
    for example in open_examples(dataset):
        size = example.rgb.shape[:2]
        mask = example.mask
        if mask is None:
            mask = np.zeros((len(example.obj_id), *size), bool)
            for one, (x, y, columns, rows) in zip(mask, example.box_px.astype(int), strict=True):
                one[y : y + rows, x : x + columns] = True
        detections.append(
            Detections(
                scene_id=example.scene_id,
                score=np.ones(len(example.obj_id)),
                obj_id=example.obj_id.copy(),
                box_px=example.box_px.copy(),
                mask=run_lengths_of(mask),
            )
        )
    return detections


@pytest.mark.slow
def test_a_world_without_masks_is_scored_by_boxes_alone(tmp_path, monkeypatch):
    masked = write_shapes(tmp_path / "own", 4)
    tests = {
        "own": {"datasets": [str(masked)]},
        "other": {"datasets": [boxes_alone(tmp_path, "theirs")]},
    }
    changed = {"tests": tests, "training": {"drawn": [str(masked)]}, "inputs": ["rgb"]}
    spec = read_study(written(tmp_path, **changed))
    detector = SimpleNamespace(network=SimpleNamespace(finds_masks=True))
    monkeypatch.setattr(study_runs, "_trained", lambda *_: detector)
    monkeypatch.setattr(study_runs, "_detections", true_detections)
    done = []
    results = run_study(spec, tmp_path / "out", on_done=done.append)
    assert done == results
    write_study(spec, results, tmp_path / "out")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "table.csv").read_text())))
    assert [(row["kind"], row["own"], row["other"], row["gap"]) for row in rows] == [
        ("box", "1.0", "1.0", "0.0"),
        ("mask", "1.0", "", ""),
    ]
    assert "| mask | - | 1.00 [1.00, 1.00] | - |" in (tmp_path / "out" / "table.md").read_text()


@pytest.mark.slow
def test_missing_data_of_a_set_is_reported_before_training(tmp_path, monkeypatch):
    masked, theirs = str(write_shapes(tmp_path / "own", 6)), boxes_alone(tmp_path, "theirs")
    monkeypatch.setattr(study_runs, "train", lambda *_, **__: pytest.fail("a training has begun"))
    own = {"own": {"datasets": [masked], "split": "test"}}
    for changed, message in (
        ({"tests": own | {"other": {"datasets": [theirs]}}}, "has no scanner depth"),
        ({"training": {"drawn": [masked, theirs]}}, "has no scanner depth"),
        (
            {
                "training": {"drawn": [theirs]},
                "inputs": ["rgb"],
                "models": [*STUDY["models"], {"model": "mask-rcnn"}],
            },
            "has no masks, which mask-rcnn needs",
        ),
    ):
        settings = {"tests": own, "training": {"drawn": [masked]}, "gap": None} | changed
        with pytest.raises(GraycastError, match=f"^{theirs}: scene .* {message}"):
            run_study(read_study(written(tmp_path, **settings)), tmp_path / "out")


@pytest.mark.slow
def test_a_study_continues_and_its_table_has_the_scores(tmp_path, capsys):
    own, other = (write_shapes(tmp_path / name, 14, seed=i) for i, name in enumerate("ab"))
    own.rename(tmp_path / "own")
    other.rename(tmp_path / "other")
    path, out = written(tmp_path), tmp_path / "out"
    assert main(["detector", "study", str(path), "--out", str(out), "--threads", "1"]) == 0
    table = (out / "table.csv").read_text()
    row = first_row(out)
    division = Split(shares=(0.5, 0.2, 0.3))
    examples = open_examples(tmp_path / "own", split="test", division=division)
    detections = read_results(
        out / "runs/yolov3_mobilenet-v3-small_rgb_default_drawn_seed0/found_own_0/results.json",
        examples.scene_ids,
    )
    labels = [labels_of(example, min_visibility=0.1) for example in examples]
    assert float(row["own"]) == pytest.approx(score(labels, detections, kind="box").ap50)
    checkpoints = {path: path.stat().st_mtime_ns for path in out.rglob("detector.pt")}
    assert main(["detector", "study", str(path), "--out", str(out), "--threads", "1"]) == 0
    assert (out / "table.csv").read_text() == table
    assert checkpoints == {path: path.stat().st_mtime_ns for path in out.rglob("detector.pt")}
    tests = STUDY["tests"] | {"other": {"datasets": ["other"], "split": "test"}}
    assert main(["detector", "study", str(written(tmp_path, tests=tests)), "--out", str(out)]) == 0
    record = json.loads(next(out.glob("runs/*_rgb_*/found_other_0/detect.json")).read_text())
    assert 0 < len(record["scene_ids"]) < 14  # not those of before
    lines = capsys.readouterr().out.splitlines()
    line = next(one for one in lines if one.startswith("yolov3_mobilenet-v3-small_rgb_default"))
    assert f"box own {float(row['own']):.2f}" in line and "box other 0." in line
