"""Commands from their words to their files, each once, where no test of their room runs them.

What the steps compute is tested in their rooms; here is that the options reach them.
"""

import csv
import json
import shutil

import numpy as np
import pytest
import yaml
from PIL import Image
from real.rescan.scene_files import true_depth_m
from real.rescan.scene_files import write_dataset as write_others
from simulated_dataset import master, master_and_samples, samples  # noqa: F401 (fixtures)
from small_cell import write_cell

from graycast.cli import main
from graycast.dataset.checking import validate


def run(capsys, *arguments):
    """What a command that ends well prints."""
    code = main([str(argument) for argument in arguments])
    printed, complaint = capsys.readouterr()
    assert code == 0, complaint
    return printed


@pytest.fixture
def copied(master, tmp_path):  # noqa: F811
    return shutil.copytree(master, tmp_path / "bins")


def test_statistics_and_the_card_of_a_dataset(copied, capsys, tmp_path):
    words = ["--out", tmp_path / "stats", "--card", "--licence", "CC-BY-4.0"]
    printed = run(capsys, "dataset", "stats", copied, *words)
    assert f"{tmp_path / 'stats'}\n" in printed and printed.endswith("README.md\n")
    figures = json.loads((tmp_path / "stats" / "stats.json").read_text())
    assert figures["scenes"] == {"train": 4}
    card = (copied / "README.md").read_text()
    assert yaml.safe_load(card.split("---\n")[1])["license"] == "CC-BY-4.0"


def test_a_licence_is_refused_before_the_dataset_is_read(capsys, tmp_path):
    words = ["dataset", "stats", str(tmp_path / "nowhere"), "--card", "--licence", "mine"]
    assert main(words) == 1
    assert "mine" in capsys.readouterr().err


def test_scanner_depth_is_scored_against_the_truth(copied, samples, capsys, tmp_path):  # noqa: F811
    """Oracle: the errors of the samples that were written."""
    out = tmp_path / "depth"
    printed = run(capsys, "dataset", "score-depth", copied, "--out", out)
    assert printed.endswith((out / "depth.md").read_text() + f"{out}\n")
    with open(out / "depth.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["of"] == "all"]
    pixels, decoded = (np.array([float(row[key]) for row in rows]) for key in ("pixels", "decoded"))
    scanned_m = np.stack([sample.scanner_depth.depth_m for sample in samples.values()])
    true_m = np.stack([sample.truth.depth_m for sample in samples.values()])
    assert pixels.sum() == np.isfinite(true_m).sum()
    assert (pixels * decoded).sum() == pytest.approx(np.isfinite(scanned_m).sum(), rel=1e-5)


def test_others_depth_is_scanned_again_and_shown(capsys, tmp_path):
    split = write_others(tmp_path / "lm", images=(0, 4), rgb=np.full((48, 64, 3), 150, np.uint8))
    out = tmp_path / "out"
    words = "--rig paper --resolution small --images 1 --copy --seed 3 --device cpu".split()
    printed = run(capsys, "rescan", split, "--out", out, *words)
    assert "2 images of" not in printed and "1 images made, 0 were there" in printed
    assert "decoded" in printed
    scene = out / "train_pbr/000000"
    assert not (scene / "depth").is_symlink() and (scene / "depth").is_dir()
    view = json.loads((scene / "scene_camera_sl.json").read_text())["0"]
    depth_m = np.array(Image.open(scene / "depth_sl/000000.png")) * view["depth_scale"] / 1e3
    known = depth_m > 0
    assert np.median(np.abs(depth_m - true_depth_m())[known]) < 5e-3 and known.mean() > 0.4
    assert validate(out) == ()
    page = run(capsys, "report", out, "--out", tmp_path / "page", "--width", 64)
    assert "1 of 1 images are drawn; open " in page
    assert (tmp_path / "page").is_dir()


def test_a_page_of_a_dataset_and_what_it_is_not_for(copied, capsys, tmp_path):
    words = ["--out", tmp_path / "page", "--workers", 1, "--width", 64]
    assert "4 scenes made, 0 were there; open " in run(capsys, "report", copied, *words)
    assert "0 scenes made, 4 were there; open " in run(capsys, "report", copied, *words)
    (copied / "picks.json").write_text("{}")
    assert main(["report", str(copied), "--out", str(tmp_path / "other")]) == 1
    assert "use graycast robot report" in capsys.readouterr().err


@pytest.mark.slow
def test_two_sets_are_compared_by_a_classifier(copied, capsys, tmp_path):
    """A set and the same set again: nothing tells them apart, and files are those of the page."""
    other = shutil.copytree(copied, tmp_path / "other")
    words = ["--classifier", "--max-maps", 2, "--seed", 1, "--out", tmp_path / "compared"]
    printed = run(capsys, "real", "compare", copied, other, *words)
    assert "AUC" in printed and printed.endswith(f"{tmp_path / 'compared'}\n")
    assert (tmp_path / "compared/classifier.md").read_text() in printed
    assert list((tmp_path / "compared").glob("*.png"))


@pytest.mark.slow
def test_the_parts_of_a_cell_are_drawn(capsys, tmp_path):
    path = write_cell(tmp_path)
    printed = run(capsys, "parts", path, "--out", tmp_path / "parts.png", "--device", "cpu")
    assert "box" in printed and "hulls" in printed
    with Image.open(tmp_path / "parts.png") as picture:
        assert np.ptp(np.array(picture)) > 50


# pycocotools 2.0.11 has an array type from before NumPy 2, which NumPy asks it to mend.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.slow
def test_a_detector_is_trained_used_scored_and_exported(copied, capsys, tmp_path):
    pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")
    pytest.importorskip("onnx", reason="needs onnx: pip install 'graycast[detect]'")
    small = "--model yolov3 --backbone mobilenet-v3-small --longest-side 96 --epochs 1 --batch 2"
    words = [
        *small.split(),
        "--shares",
        "0.5,0.25,0.25",
        "--split-seed",
        3,
        "--one-class",
        "--device",
        "cpu",
    ]
    printed = run(capsys, "detector", "train", copied, "--out", tmp_path / "run", *words)
    assert "epoch 1: loss " in printed
    found = tmp_path / "found"
    words = ["--drawings", 2, "--min-score", 0, "--max-detections", 5, "--device", "cpu"]
    run(capsys, "detector", "find", tmp_path / "run", copied, "--out", found, *words)
    assert len(list((found / "drawings").glob("*.jpg"))) == 2
    scores = tmp_path / "scores"
    words = ["--on", copied, "--out", scores, "--one-class", "--resamples", 20]
    assert "AP" in run(capsys, "detector", "score", found / "results.json", *words)
    onnx = tmp_path / "detector.onnx"
    assert f"{onnx}: written" in run(capsys, "detector", "onnx", tmp_path / "run", "--out", onnx)
    assert onnx.stat().st_size > 1e5
