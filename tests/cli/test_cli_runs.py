"""Commands from their options to their files, if no test of their room runs them.

The results of the steps are tested in their rooms, and their options here.
"""

import csv
import json
import re
import shutil
import sys
from argparse import Namespace
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from drawn import no_pixels
from PIL import Image
from real.rescan.scene_files import true_depth_m
from real.rescan.scene_files import write_dataset as write_others
from simulated_dataset import master, master_and_samples, samples  # noqa: F401 (fixtures)
from small_cell import write_cell

from graycast.base.errors import GraycastError
from graycast.camera.decode import Reason
from graycast.cell.engine import Failed
from graycast.cli import main, robot_commands
from graycast.dataset.check.checking import validate
from graycast.dataset.export import Split
from graycast.real.rescan import open_source, rescanning
from graycast.real.rescan.source import SourceOptions
from graycast.robot.pick import load_pick_config


def run(capsys, *arguments):
    """Return the output of a command that succeeds."""
    code = main([str(argument) for argument in arguments])
    printed, complaint = capsys.readouterr()
    assert code == 0, complaint
    return printed


@pytest.fixture
def copied(master, tmp_path):  # noqa: F811
    return shutil.copytree(master, tmp_path / "bins")


@pytest.mark.slow
def test_dataset_stats_writes_the_statistics_and_the_card(copied, capsys, tmp_path):
    words = ["--out", tmp_path / "stats", "--card", "--licence", "CC-BY-4.0"]
    printed = run(capsys, "dataset", "stats", copied, *words)
    assert f"{tmp_path / 'stats'}\n" in printed and printed.endswith("README.md\n")
    figures = json.loads((tmp_path / "stats" / "stats.json").read_text())
    assert figures["scenes"] == {"train": 4}
    card = (copied / "README.md").read_text()
    assert yaml.safe_load(card.split("---\n")[1])["license"] == "CC-BY-4.0"


def test_a_wrong_licence_is_refused_before_the_dataset_is_read(capsys, tmp_path):
    words = ["dataset", "stats", str(tmp_path / "nowhere"), "--card", "--licence", "mine"]
    assert main(words) == 1
    assert "mine" in capsys.readouterr().err


@pytest.mark.slow
def test_the_depth_of_the_scanner_is_scored_against_the_truth(copied, samples, capsys, tmp_path):  # noqa: F811
    """Oracle: the errors of the written samples."""
    out = tmp_path / "depth"
    with no_pixels():
        printed = run(capsys, "dataset", "score-depth", copied, "--out", out)
    assert printed.endswith((out / "depth.md").read_text() + f"{out}\n")
    with open(out / "depth.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["of"] == "all"]
    pixels, decoded = (np.array([float(row[key]) for row in rows]) for key in ("pixels", "decoded"))
    scanned_m = np.stack([sample.scanner_depth.depth_m for sample in samples.values()])
    true_m = np.stack([sample.truth.depth_m for sample in samples.values()])
    assert pixels.sum() == np.isfinite(true_m).sum()
    assert (pixels * decoded).sum() == pytest.approx(np.isfinite(scanned_m).sum(), rel=1e-5)


EXPORTS = {
    "coco": (
        "--picture gray --depth-files perfect --polygons --link --min-visibility 0.3",
        {
            "image": "gray",
            "depth": "perfect",
            "polygons": True,
            "link": True,
            "min_visibility": 0.3,
        },
    ),
    "yolo": ("--labels boxes", {"labels": "boxes"}),
    "bop-webdataset": (
        "--shard-scenes 2 --pixel-origin corner",
        {"shard_scenes": 2, "pixel_origin": "corner"},
    ),
    "clouds": (
        "--cloud pcd --organised --depth-files scanner",
        {"cloud": "pcd", "organised": True, "depth": "scanner"},
    ),
}


# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("form", EXPORTS)
def test_an_export_records_its_options(copied, capsys, tmp_path, form):
    words, options = EXPORTS[form]
    out = tmp_path / "export"
    run(capsys, "dataset", "export", copied, "--format", form, "--out", out, *words.split())
    record = json.loads((out / "export.json").read_text())
    assert record["format"] == form and record["options"].items() >= options.items()


@pytest.mark.parametrize("former", ["bop-imagewise", "webdataset"])
def test_the_error_for_a_former_export_format_names_its_replacement(capsys, former):
    with pytest.raises(SystemExit) as ended:
        main(["dataset", "export", "out", "--format", former, "--out", "export"])
    assert ended.value.code == 2
    assert f"the format {former} is no longer written or read: export as bop-webdataset" in (
        capsys.readouterr().err
    )


@pytest.mark.slow
def test_maps_of_reasons_are_read_with_depth(capsys, tmp_path):
    """Two thirds of the depth are missing, half of them for each of two reasons."""
    depth_m = np.full((60, 90), np.nan)
    depth_m[:, :30] = 0.8 + 1e-3 * np.random.default_rng(0).random((60, 30))
    np.save(tmp_path / "z.npy", depth_m)
    reason = np.full((60, 90), Reason.SHADOW, np.uint8)
    reason[:, :30], reason[:, 30:60] = Reason.DECODED, Reason.SATURATED
    Image.fromarray(reason).save(tmp_path / "r.png")
    words = ["--intrinsics", "100,100,45,30", "--reason", tmp_path / "r.png"]
    with no_pixels():
        run(capsys, "real", "measure", tmp_path / "z.npy", *words, "--out", tmp_path / "out")
    missing = json.loads((tmp_path / "out/realism.json").read_text())["missing"]
    assert missing["share"] == pytest.approx(2 / 3)
    shares = {name: share for name, share in missing["by_reason"].items() if share}
    assert set(shares) == {"saturated", "shadow"} and len(set(shares.values())) == 1


def test_the_options_of_the_command_are_passed_to_the_rescan(capsys, tmp_path, monkeypatch):
    record = {}

    def opened(path, options):
        record.update(path=path, options=options)
        return SimpleNamespace(
            images=((0, 0), (0, 1)), folder=path, parts={}, plain=(), notes=("odd depth",)
        )

    def scan(source, scanner, out, spec, *, workers, **watchers):
        record.update(scanner=scanner, out=out, spec=spec, workers=workers)
        return rescanning.RescanSummary(
            written=1, there=1, set_aside={(0, 1): "dark"}, seconds=1.0, reasons={}, part_reasons={}
        )

    monkeypatch.setattr(open_source, "open_source", opened)
    monkeypatch.setattr(rescanning, "rescan", scan)
    words = (
        "rescan d --rig paper --resolution small --out o --camera rig --models m "
        "--materials k.yaml --sensor left --depth-scale 0.5 --intrinsics 1,2,3,4 --depth-only "
        "--unit m --ray-length "
        "--images 7 --copy --seed 3 --backend cycles --device cpu --workers 2"
    )
    assert main(words.split()) == 1  # An image is set aside.
    printed = capsys.readouterr().out
    assert "image 000000/000001 is set aside: dark" in printed and "note: odd depth" in printed
    assert record["options"] == SourceOptions(
        sensor="left", models=Path("m"), materials=Path("k.yaml"), depth_scale_mm=0.5,
        intrinsics="1,2,3,4", depth_only=True, unit="m", ray_length=True,
    )  # fmt: skip
    spec = record["spec"]
    assert (spec.camera, spec.seed, spec.images, spec.copies) == ("rig", 3, 7, True)
    assert (spec.render.backend, spec.device) == ("cycles", "cpu")
    assert (record["path"], record["out"]) == (Path("d"), Path("o"))
    assert (record["scanner"].rig.name, record["workers"].count) == ("paper", 2)


@pytest.mark.parametrize(
    ("words", "picking"),
    [
        ({"detector": "truth"}, {"detector": "truth"}),
        ({"detector": "nuts"}, {"detector": str(Path("nuts").absolute())}),
        ({"depth": "perfect"}, {"depth": "perfect", "depth_noise_m": None}),
        ({"depth": "0.002"}, {"depth": "noisy", "depth_noise_m": 0.002}),
        ({"pose": "truth"}, {"pose": "truth"}),
    ],
)
def test_options_select_how_much_the_robot_knows(tmp_path, words, picking):
    path = write_cell(tmp_path, "scenes", robot={"arm": "ur5e", "base_m": [-0.5, 0.0, 0.0]})
    options = Namespace(**{"detector": None, "pose": None, "depth": None, "config": path} | words)
    config = robot_commands._with_options(load_pick_config(path), options)
    assert config.picking.model_dump(mode="json").items() >= picking.items()


def test_impossible_options_of_a_robot_are_refused_in_one_line(tmp_path, capsys):
    path = write_cell(tmp_path, "scenes", robot={"arm": "ur5e", "base_m": [-0.5, 0.0, 0.0]})
    options = Namespace(detector="none", pose=None, depth=None, config=path)
    with pytest.raises(GraycastError) as caught:
        robot_commands._with_options(load_pick_config(path), options)
    assert str(caught.value).startswith(f"{path}: ") and "give truth or a folder" in str(
        caught.value
    )
    assert "pydantic" not in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(
        GraycastError, match="--depth is 'deep': give scanner, perfect, or a number"
    ):
        robot_commands._depth("deep")


def stop(*_, **__):
    raise KeyboardInterrupt


def stopped(capsys, *arguments):
    assert main([str(argument) for argument in arguments]) == 130
    start = "graycast: the command was stopped; "
    return capsys.readouterr().err.strip().removeprefix(start)


def test_a_preview_is_not_written_if_it_is_stopped_during_trials(capsys, monkeypatch, tmp_path):
    """Trying changes takes longer than drawing, which used to come first."""
    manifest = {"part_reasons": {}, "reasons": {}}
    sample = SimpleNamespace(scene=None, layout=None, manifest=manifest)
    shot = SimpleNamespace(sample=sample)
    renderer = SimpleNamespace(name="none", device="cpu")
    for place, value in {
        "cell.resolve.open_cell_renderer": lambda *_, **__: nullcontext(renderer),
        "cell.simulate.make_images": lambda *_, **__: iter([shot]),
        "cell.framing.framing_line": lambda *_: "",
        "cli.scene_commands._tell_coarse": lambda _: None,
        "show.report.draw_preview": lambda shot, code, out: out.write_bytes(b""),
        "cell.remedies.depth_note": stop,
    }.items():
        monkeypatch.setattr(f"graycast.{place}", value)
    out = tmp_path / "p.png"
    message = stopped(capsys, "preview", write_cell(tmp_path), "--out", out)
    assert message == "nothing was written"
    assert not out.exists()


def test_a_stopped_page_of_a_rescan_leaves_no_file(capsys, monkeypatch, tmp_path):
    """It is written in one piece; the message used to say that the finished scenes were kept."""
    monkeypatch.setattr("graycast.dataset.read.rescanned.is_rescanned", lambda _: True)
    monkeypatch.setattr("graycast.show.report.rescan_page.write_rescan_page", stop)
    page = tmp_path / "page"
    assert stopped(capsys, "report", tmp_path, "--out", page) == "nothing was written"


def test_statistics_are_written_even_if_the_card_is_stopped(capsys, monkeypatch, tmp_path):
    for place, value in {
        "dataset.stats.dataset_statistics": lambda *_, **__: None,
        "dataset.stats.statistics_table": lambda _: "",
        "dataset.stats.write_statistics": lambda _, out: out.mkdir(),
        "dataset.card.write_card": stop,
    }.items():
        monkeypatch.setattr(f"graycast.{place}", value)
    out = tmp_path / "stats"
    message = stopped(capsys, "dataset", "stats", tmp_path, "--out", out, "--card")
    assert message == f"{out} is written, the card is not"
    assert out.exists()


@pytest.fixture(params=["robot pick", "rig design", "dataset grasps"])
def failing(request, monkeypatch, tmp_path):
    """Return the output of a command whose task 3 fails twice, the second time for good."""

    def failed(final):
        return Failed(scene_id=3, error=OSError("no memory"), final=final)

    def run_to_nowhere(*_, on_failed, **__):
        for final in (False, True):
            on_failed(*words[request.param], failed(final))
        return (left[request.param],)

    words = {"robot pick": (), "rig design": ("near", 3), "dataset grasps": ("train/000003",)}
    left = {"robot pick": 3, "rig design": "near/003", "dataset grasps": "train/000003"}
    whole_cell = SimpleNamespace(scene=SimpleNamespace(parts=(), rig=SimpleNamespace(name="r")))
    for place, value in {
        "robot.pick.resolve_pick_cell": lambda *_, **__: SimpleNamespace(cell=whole_cell),
        "robot.pick.pick": run_to_nowhere,
        "robot.pick.read_episodes": lambda _: (),
        "robot.pick.summarize": lambda _: None,
        "score.design.run_design": run_to_nowhere,
        "score.design.write_design": lambda *_: None,
        "score.design.describe_design": lambda *_: "",
        "robot.grasp_labels.label_dataset": run_to_nowhere,
        "robot.grasp_labels.rank": lambda *_: None,
        "robot.grasp_labels.describe_ranking": lambda _: "",
    }.items():
        monkeypatch.setattr(f"graycast.{place}", value)
    monkeypatch.setattr(robot_commands, "_tell", lambda _: None)
    monkeypatch.setattr(robot_commands, "_need_robot", lambda: None)
    monkeypatch.setitem(sys.modules, "coal", SimpleNamespace())
    configs = Path(__file__).parents[2] / "configs"
    cell = configs / "cells/ur5e_suction.yaml"
    first = {
        "robot pick": [cell],
        "rig design": [configs / "design/brackets.yaml"],
        "dataset grasps": [tmp_path, "--tool", cell],
    }[request.param]
    return [str(word) for word in (*request.param.split(), *first)]


def test_a_failed_scene_reports_its_next_attempt_and_the_end_lists_missing_scenes(
    failing, capsys, tmp_path
):
    """A failed first try used to be printed as a "failed" bin, which the same run then emptied."""
    out = [] if "grasps" in failing else ["--out", str(tmp_path / "out")]
    assert main([*failing, *out]) == 1
    printed = capsys.readouterr().out
    lines = re.findall(r"0+3  (.*): no memory", printed)
    assert lines == ["will be made again", "given up"]
    assert re.search(r"0+3 is missing; run the same command again to retry it", printed)


@pytest.mark.slow
def test_a_dataset_of_another_program_is_rescanned_and_shown(capsys, tmp_path):
    split = write_others(tmp_path / "lm", images=(0, 4), rgb=np.full((48, 64, 3), 150, np.uint8))
    out = tmp_path / "out"
    words = "--rig paper --resolution small --images 1 --copy --seed 3 --device cpu".split()
    printed = run(capsys, "rescan", split, "--out", out, *words)
    assert printed.startswith("1 images of ") and "1 images made, 0 were there" in printed
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


def test_report_writes_a_page_and_refuses_options_that_do_not_apply(copied, capsys, tmp_path):
    words = ["--out", tmp_path / "page", "--workers", 1, "--width", 64]
    assert "4 scenes made, 0 were there; open " in run(capsys, "report", copied, *words)
    assert "0 scenes made, 4 were there; open " in run(capsys, "report", copied, *words)
    (copied / "picks.json").write_text("{}")
    assert main(["report", str(copied), "--out", str(tmp_path / "other")]) == 1
    assert "use graycast robot report" in capsys.readouterr().err


@pytest.mark.slow
def test_two_sets_are_compared_by_a_classifier(copied, capsys, tmp_path):
    """For a set and itself, the classifier finds no difference, and the files are the page's."""
    other = shutil.copytree(copied, tmp_path / "other")
    words = ["--classifier", "--max-maps", 2, "--seed", 1, "--out", tmp_path / "compared"]
    printed = run(capsys, "real", "compare", copied, other, *words)
    assert "AUC" in printed and printed.endswith(f"{tmp_path / 'compared'}\n")
    assert (tmp_path / "compared/classifier.md").read_text() in printed
    assert list((tmp_path / "compared").glob("*.png"))


@pytest.mark.parametrize(
    "words", ["preview cell.yaml", "parts", "rig show paper", "robot summary picks"]
)
def test_a_picture_with_another_suffix_than_png_is_refused(capsys, words):
    with pytest.raises(SystemExit):
        main([*words.split(), "--out", "picture.jpg"])
    assert "'picture.jpg' is not the name of a PNG file: end it with" in capsys.readouterr().err


@pytest.mark.slow
def test_preview_draws_the_parts_of_a_cell(capsys, tmp_path):
    path = write_cell(tmp_path)
    printed = run(capsys, "parts", path, "--out", tmp_path / "parts.png", "--device", "cpu")
    assert "box" in printed and "hulls" in printed
    with Image.open(tmp_path / "parts.png") as picture:
        assert np.ptp(np.array(picture)) > 50


@pytest.mark.slow
def test_the_options_of_the_command_are_passed_to_the_training(capsys, monkeypatch, tmp_path):
    pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")
    from graycast.learn import detect
    from graycast.learn.detect import Augmentation, TrainSpec

    record = {}

    def trained(datasets, out, spec, **watchers):
        record.update(datasets=datasets, out=out, spec=spec)
        raise GraycastError("enough")

    monkeypatch.setattr(detect, "train", trained)
    (tmp_path / "w.pth").write_bytes(b"")
    words = (
        "detector train a b --out o --model solov2 --input rgbd --one-class --backbone resnet50 "
        f"--weights {tmp_path / 'w.pth'} --longest-side 200 --epochs 3 --patience 2 --batch 5 "
        "--learning-rate 0.01 --shares 0.6,0.2,0.2 --split-seed 4 --min-visibility 0.3 "
        "--holes zero --no-relief --range 0.5,1.5 --no-flips --seed 9 --device cpu --readers 1"
    )
    assert main(words.split()) == 1 and "enough" in capsys.readouterr().err
    assert (record["datasets"], record["out"]) == ([Path("a"), Path("b")], Path("o"))
    assert record["spec"] == TrainSpec(
        model="solov2", input="rgbd", one_class=True, backbone="resnet50",
        weights=tmp_path / "w.pth", longest_px=200, epochs=3, patience=2, batch=5,
        learning_rate=0.01, split=Split(shares=(0.6, 0.2, 0.2), seed=4), min_visibility=0.3,
        holes="zero", relief=False, range_m=(0.5, 1.5), augmentation=Augmentation(flip=False),
        seed=9, device="cpu", workers=1,
    )  # fmt: skip


# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
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
    folder = tmp_path / "found"
    words = ["--drawings", 2, "--min-score", 0, "--max-detections", 5, "--device", "cpu"]
    run(capsys, "detector", "find", tmp_path / "run", copied, "--out", folder, *words)
    assert len(list((folder / "drawings").glob("*.jpg"))) == 2
    scores = tmp_path / "scores"
    words = ["--on", copied, "--out", scores, "--one-class", "--resamples", 20]
    assert "AP" in run(capsys, "detector", "score", folder / "results.json", *words)
    onnx = tmp_path / "detector.onnx"
    assert f"{onnx}: written" in run(capsys, "detector", "onnx", tmp_path / "run", "--out", onnx)
    assert onnx.stat().st_size > 1e5
