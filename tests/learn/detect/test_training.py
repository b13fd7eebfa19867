"""Test that training learns, resumes with equal results, and reports mistakes."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from drawn import no_pixels
from learn.detect.drawn import write_shapes

import graycast
from benchmarks import detectors as bench_detectors
from graycast.base.errors import GraycastError
from graycast.cli import main
from graycast.dataset.export.split import Split
from graycast.dataset.read.detections import read_results
from graycast.dataset.training import open_examples
from graycast.learn.detect import TrainSpec, detect, load_detector, pictures_of, train, training
from graycast.learn.detect.detector import Detector, without_denormals
from graycast.learn.detect.network import Network, NetworkOutput, Recipe
from graycast.learn.detect.networks import network_class
from graycast.learn.detect.run import RunFolder
from graycast.learn.detect.training import _settings, _shape
from graycast.learn.detect.training_pictures import NO_AUGMENTATION, Augmentation, room_for
from graycast.score.evaluate import labels_of, score

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SMALL = TrainSpec(
    model="yolov3",
    backbone="mobilenet-v3-small",
    longest_px=128,
    epochs=2,
    batch=2,
    split=Split(shares=(0.7, 0.3, 0.0)),
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    return write_shapes(tmp_path_factory.mktemp("drawn"), 10)


def weights(run: Path) -> dict:
    return torch.load(run / "detector.pt", weights_only=True)["state"]


def same(a: dict, b: dict) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


@pytest.mark.slow
def test_equal_seeds_give_equal_detectors_and_other_seeds_give_other_detectors(dataset, tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train([dataset], tmp_path / name, replace(SMALL, seed=seed))
    assert same(weights(tmp_path / "a"), weights(tmp_path / "b"))
    assert not same(weights(tmp_path / "a"), weights(tmp_path / "c"))


@pytest.mark.slow
def test_a_run_has_all_files_that_its_readers_need(dataset, tmp_path):
    train([dataset], tmp_path / "run", SMALL)
    rows = (tmp_path / "run" / "history.csv").read_text().splitlines()
    assert rows[0].startswith("epoch,step,loss") and len(rows) == 1 + SMALL.epochs
    assert (tmp_path / "run" / "curves.png").read_bytes().startswith(b"\x89PNG")
    detector = load_detector(tmp_path / "run")
    encoding = detector.about.encoding
    assert detector.about.names == ("disc", "box")
    assert encoding.near_m < 0.9 < 1.0 < encoding.far_m  # the drawn floor and tops
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    train_ids, val_ids = (record["trained"]["datasets"][0][name] for name in ("train", "val"))
    assert sorted(train_ids + val_ids) == list(range(10)) and len(val_ids) == 3


@pytest.mark.slow
def test_a_finished_run_is_not_trained_again(dataset, tmp_path):
    """Files that a kill after the last checkpoint left out are written from the checkpoint."""
    run = tmp_path / "run"
    train([dataset], run, SMALL)
    before, history = (run / "checkpoint.pt").stat().st_mtime_ns, (run / "history.csv").read_text()
    (run / "history.csv").write_text("".join(history.splitlines(keepends=True)[:-1]))
    (run / "curves.png").unlink()
    train([dataset], run, SMALL)
    assert (run / "checkpoint.pt").stat().st_mtime_ns == before
    assert (run / "history.csv").read_text() == history and (run / "curves.png").is_file()


def test_the_learning_rate_rises_linearly_and_falls_as_a_cosine():
    """Oracle: its values at the ends, at the top and half way down."""
    assert _shape(0.05) == pytest.approx(1.0)
    assert _shape(0.025) == pytest.approx(0.5)
    assert _shape(0.525) == pytest.approx(0.505)
    assert _shape(1.0) == pytest.approx(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["yolov3", pytest.param("mask-rcnn", marks=pytest.mark.slow)])
def test_detections_of_a_run_are_read_back_from_files(dataset, run, tmp_path, model):
    """The files hold the detections of the detector, in pixels of the pictures."""
    if model == SMALL.model:
        detector = load_detector(run)
    else:
        detector = train([dataset], tmp_path / "run", replace(SMALL, model=model, epochs=1))
    pictures = pictures_of(dataset, detector.about, split="all", scale_m=None)
    result = detect(detector, pictures, tmp_path / "found")
    detections = read_results(tmp_path / "found" / "results.json", range(10))
    assert [len(each) for each in detections] == [len(each) for each in result.found]
    assert (detections[0].mask is None) == (model == "yolov3")
    box = np.concatenate([each.box_px for each in detections])
    assert (box[:, :2] >= 0).all() and (box[:, 0] + box[:, 2] <= 128.001).all()
    assert len(list((tmp_path / "found" / "drawings").iterdir())) == 10


@pytest.mark.slow
def test_training_restores_the_arithmetic_of_the_processor(dataset, run, tmp_path):
    """SciPy's k-d tree recurses without end if denormal differences are flushed to zero."""
    torch.set_flush_denormal(False)
    example = open_examples(dataset)[0]
    load_detector(run).detect(example, obj_ids={"disc": 1, "box": 2})
    train([dataset], tmp_path / "run", replace(SMALL, epochs=1))
    tiny = np.full(4, 1e-310)
    assert (tiny * 0.5 > 0).all() and (tiny[0] - tiny[1] * 0.5) > 0


@pytest.mark.slow
@pytest.mark.parametrize(("model", "epochs"), [("mask-rcnn", 14), ("yolov3", 40)])
def test_a_trained_detector_recognises_shapes_in_unseen_pictures(tmp_path, model, epochs):
    """AP is high on unseen pictures; a detector with a wrong scale of boxes has almost 0."""
    dataset = write_shapes(tmp_path, 40, seed=3)
    spec = replace(
        SMALL, model=model, epochs=epochs, batch=4, split=Split(shares=(0.6, 0.15, 0.25))
    )
    detector = train([dataset], tmp_path / "run", spec)
    examples = open_examples(dataset, split="test", division=spec.split)
    ids = {"disc": 1, "box": 2}
    detections = [detector.detect(example, obj_ids=ids) for example in examples]
    labels = [labels_of(example, min_visibility=0.1) for example in examples]
    for kind in ("box", "mask") if model == "mask-rcnn" else ("box",):
        assert score(labels, detections, kind=kind).ap50 >= 0.7, kind


SMALL_NETWORK = "--model yolov3 --backbone mobilenet-v3-small --longest-side 128"
COMMAND = [sys.executable, "-W", "ignore", "-m", "graycast", "detector", "train"]


def command(dataset, out, *, epochs=8):
    options = f"{SMALL_NETWORK} --batch 2 --shares 0.7,0.3,0"
    return [
        *COMMAND, str(dataset), "--out", str(out), *options.split(), "--epochs", str(epochs),
        "--device", "cpu", "--threads", "1",
    ]  # fmt: skip


@pytest.mark.slow
def test_a_killed_training_continues_to_the_same_weights(dataset, tmp_path, monkeypatch):
    """Kill the run (kill -9) at three different points, each time before the same command."""
    subprocess.run(command(dataset, tmp_path / "whole"), check=True, capture_output=True)
    run, killed = tmp_path / "killed", 0
    for share in (0.1, 0.5, 0.9):
        process = subprocess.Popen(
            command(dataset, run), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + 120
        goal = round(6 * share)  # three epochs remain after the last kill
        while process.poll() is None and time.monotonic() < deadline:
            if _epochs(run) >= goal and (goal or (run / "cache" / "val.npy").exists()):
                time.sleep(0.15 * killed)
                os.kill(process.pid, signal.SIGKILL)
                killed += process.wait() == -signal.SIGKILL
                break
            time.sleep(0.01)
    assert killed == 3
    subprocess.run(command(dataset, run), check=True, capture_output=True)
    assert same(weights(run), weights(tmp_path / "whole"))
    histories = [
        (folder / "history.csv").read_text().splitlines() for folder in (run, tmp_path / "whole")
    ]
    assert histories[0] == histories[1]


def _epochs(run: Path) -> int:
    file = run / "history.csv"
    return len(file.read_text().splitlines()) - 1 if file.is_file() else 0


def refusal(capsys, *arguments) -> str:
    assert main([str(each) for each in arguments]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("graycast: error: "), lines
    return lines[0]


@pytest.mark.slow
def test_invalid_trainings_are_refused_in_one_line(dataset, tmp_path, capsys):
    """Each mistake names the thing and the remedy."""
    options = f"{SMALL_NETWORK} --epochs 1 --batch 2".split()
    out = tmp_path / "run"

    def message(*arguments, data=dataset, to=out):
        return refusal(capsys, "detector", "train", data, "--out", to, *options, *arguments)

    assert "is not a Graycast dataset" in message(data=tmp_path / "nowhere")
    assert "no backbone 'vgg'" in message("--backbone", "vgg", to=tmp_path / "v")
    assert "split: val gets none" in message("--shares", "0.99,0.01,0", to=tmp_path / "s")
    assert "does not exist: give a file of weights" in message(
        "--weights", tmp_path / "no.pth", to=tmp_path / "w"
    )
    (tmp_path / "text.pth").write_text("no weights")
    assert "is damaged or is not a file of weights" in message(
        "--weights", tmp_path / "text.pth", to=tmp_path / "w2"
    )
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    assert "is not empty and holds no run" in message(to=tmp_path / "full")
    (tmp_path / "file").write_text("")
    assert "is a file: choose a folder" in message(to=tmp_path / "file")


@pytest.mark.slow
def test_a_run_is_not_resumed_with_other_settings(dataset, tmp_path, capsys):
    train([dataset], tmp_path / "run", SMALL)
    with pytest.raises(
        GraycastError, match=r"differs in trained\.settings\.seed \(0 there, 1 here\)"
    ):
        train([dataset], tmp_path / "run", replace(SMALL, seed=1))
    with pytest.raises(GraycastError, match=r"is a run that differs in .*choose another --out"):
        train([dataset], tmp_path / "run", replace(SMALL, model="mask-rcnn"))


OTHER = {
    "model": "mask-rcnn",
    "input": "depth",
    "backbone": "resnet18",
    "longest_px": 129,
    "holes": "zero",
    "relief": False,
    "p_wrong": True,
    "range_m": (0.5, 1.0),
    "epochs": 3,
    "batch": 3,
    "learning_rate": 1e-3,
    "seed": 1,
    "one_class": True,
    "min_visibility": 0.2,
    "patience": 11,
    "split": Split(shares=(0.7, 0.3, 0.0), seed=1),
    "augmentation": Augmentation(),
    "device": "cpu",
    "workers": 1,
}


def test_every_setting_that_changes_weights_is_in_the_claim_of_a_run(tmp_path):
    small = replace(SMALL, augmentation=NO_AUGMENTATION)
    changed = {name: _settings(replace(small, **{name: value})) for name, value in OTHER.items()}
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "body.pth").write_text(name)
    one, other = (
        _settings(replace(small, weights=tmp_path / name / "body.pth")) for name in ("a", "b")
    )
    assert one != other  # The two files have one name.
    changed["weights"] = one
    assert set(changed) == {field.name for field in fields(TrainSpec)}
    alike = {name for name, settings in changed.items() if settings == _settings(small)}
    assert alike == {"device", "workers"}


@pytest.mark.slow
def test_a_training_is_not_resumed_with_changed_data(dataset, tmp_path):
    """A dataset replaced between the halves of a training was once taken for the first one."""
    own = shutil.copytree(dataset, tmp_path / "own")
    stop, detector = SimpleNamespace(ended=True), object.__new__(Detector)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "_Training", lambda *_: stop)
        patch.setattr(training, "load_detector", lambda *_, **words: detector)
        train([own], tmp_path / "run", SMALL)
        (tmp_path / "run/checkpoint.pt").write_bytes(b"half of it")
        assert train([own], tmp_path / "run", SMALL) is detector
        origin = open_examples(own, split="train", division=SMALL.split).origins[0]
        manifest = json.loads(origin.read_text())
        origin.write_text(json.dumps(manifest | {"manifest_sha256": 64 * "0"}))
        words = r"differs in trained\.datasets\[0\]\.content\[0\] .* with the same data"
        with pytest.raises(GraycastError, match=words):
            train([own], tmp_path / "run", SMALL)


@pytest.mark.slow
def test_a_training_that_fails_at_the_start_does_not_occupy_its_folder(dataset, tmp_path):
    """Train with a misspelt backbone, then with the right one in the same folder."""
    for changed in ({"backbone": "vgg"}, {"weights": tmp_path / "nowhere.pth"}):
        with pytest.raises(GraycastError):
            train([dataset], tmp_path / "run", replace(SMALL, **changed))
        assert not (tmp_path / "run").exists()
    with pytest.raises(GraycastError, match="the loss is not a number after"):
        train([dataset], tmp_path / "run", replace(SMALL, learning_rate=1e30, epochs=20))
    train([dataset], tmp_path / "run", SMALL)


def test_partial_files_of_a_killed_training_are_removed_by_the_next_training(tmp_path):
    """The first file is included, although no other file marks the folder as a training's."""
    for left in (".tmp-run.json-dead", ".tmp-checkpoint.pt-dead"):
        run = RunFolder(tmp_path)
        (tmp_path / left).write_bytes(b"half")
        with run.claimed({"seed": 0}):
            assert {path.name for path in tmp_path.iterdir()} == {".lock", "run.json"}


@pytest.mark.slow
def test_two_trainings_in_one_folder_are_refused(dataset, tmp_path):
    """The refusal holds before the first checkpoint, and only while the other training runs."""
    other = RunFolder(tmp_path / "run")
    with other.claimed({}):
        with pytest.raises(
            GraycastError,
            match="another training runs in this folder: wait until it ends, or choose",
        ):
            train([dataset], tmp_path / "run", replace(SMALL, epochs=1))
        assert json.loads((tmp_path / "run" / "run.json").read_text()) == {}
    train([dataset], tmp_path / "run", replace(SMALL, epochs=1))


def test_the_network_is_timed_in_the_arithmetic_used_for_detection(dataset, run, monkeypatch):
    """Both timings use mixed precision if available, and no denormals, so they are comparable."""
    monkeypatch.setattr(
        "graycast.learn.detect.detector.autocast",
        lambda device: torch.autocast("cpu", torch.bfloat16),
    )
    detector, states = load_detector(run, device="cpu"), []

    def find(image, *, most, least_score):
        tiny = np.full(1, np.finfo(float).tiny)
        states.append((torch.is_autocast_enabled("cpu"), (tiny / 2 == 0).all()))
        none = torch.zeros(0)
        return [NetworkOutput(box=torch.zeros(0, 4), label=none.long(), score=none, mask=None)]

    monkeypatch.setattr(detector.network, "find", find)
    bench_detectors._detection(detector, dataset)
    assert len(states) >= 2 * 5 and all(cast and flushed for cast, flushed in states)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("capabilities", "mixed"),
    [({"avx512_bf16": True}, True), ({"amx_bf16": True}, True), ({"avx512_f": True}, False)],
)
def test_a_processor_that_supports_bfloat16_trains_in_bfloat16(
    dataset, tmp_path, monkeypatch, capabilities, mixed
):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities, raising=False)
    casts, conv2d = set(), torch.nn.functional.conv2d
    monkeypatch.setattr(
        torch.nn.functional,
        "conv2d",
        lambda *args, **kwargs: (
            casts.add(torch.is_autocast_enabled("cpu")) or conv2d(*args, **kwargs)
        ),
    )
    detector = train([dataset], tmp_path / "run", replace(SMALL, epochs=1))
    assert casts == {mixed}
    kernels = [w for w in detector.network.parameters() if w.ndim == 4 and min(w.shape) > 1]
    assert kernels and all(w.is_contiguous(memory_format=torch.channels_last) for w in kernels)
    assert {w.dtype for w in detector.network.parameters()} == {torch.float32}


def test_denormals_return_when_the_outer_block_without_them_ends():
    torch.set_flush_denormal(False)
    tiny = np.full(1, np.finfo(float).tiny)
    with without_denormals():
        with without_denormals():
            assert tiny[0] / 2 == 0
        assert tiny[0] / 2 == 0
    assert tiny[0] / 2 > 0


@pytest.mark.slow
def test_weights_of_another_model_are_refused(dataset, tmp_path):
    train([dataset], tmp_path / "run", SMALL)
    with pytest.raises(GraycastError, match=r"detector\.pt: these weights do not belong to"):
        train(
            [dataset],
            tmp_path / "other",
            replace(SMALL, model="mask-rcnn", weights=tmp_path / "run" / "detector.pt"),
        )
    again = train(
        [dataset],
        tmp_path / "again",
        replace(SMALL, weights=tmp_path / "run" / "detector.pt", epochs=1),
    )
    assert again.about.names == ("disc", "box")


class OwnNetwork(Network):
    """A user's network with one box; it learns only the box's corners and score."""

    finds_masks = False
    recipe = Recipe(learning_rate=1e-2, batch=4, weight_decay=0.0)

    def __init__(self, *, channels, classes, backbone, size_px):
        super().__init__()
        self.linear = torch.nn.Linear(channels, 1)
        self.box = torch.nn.Parameter(torch.tensor([8.0, 8.0, 40.0, 40.0]))

    def losses(self, image, targets):
        wanted = torch.cat([target.box for target in targets] + [torch.zeros(1, 4)])
        return {
            "box": (self.box - wanted).abs().mean(),
            "score": self.linear(image.mean(dim=(2, 3))).square().mean(),
        }

    def find(self, image, *, most, least_score):
        score = self.linear(image.mean(dim=(2, 3))).sigmoid()
        label = torch.zeros(1, dtype=torch.int64)
        box = self.box.detach()[None]
        return [NetworkOutput(box=box, label=label, score=one, mask=None) for one in score]


@pytest.mark.slow
def test_a_network_of_the_user_is_trained_saved_and_read_with_its_class(dataset, tmp_path):
    """Oracle: each step of AdamW without decay moves a weight by the learning rate at most."""
    detector = graycast.train([dataset], tmp_path / "run", SMALL, network=OwnNetwork)
    assert detector.about.model == "OwnNetwork"
    again = graycast.load_detector(tmp_path / "run", network=OwnNetwork)
    box = again.network.box.detach()
    assert torch.equal(box, detector.network.box)
    moved = (box - torch.tensor([8.0, 8.0, 40.0, 40.0])).abs()
    assert 0 < moved.min() and moved.max() < 2 * 4 * 1.01 * 1e-2  # 2 epochs of at most 4 steps
    detections = again.detect(open_examples(dataset)[0], obj_ids={"disc": 1, "box": 2})
    scale = again.about.encoding.scale((96, 128))
    np.testing.assert_allclose(detections.box_px[0, :2], box[:2] / scale, rtol=1e-6)
    with pytest.raises(GraycastError, match=r"'OwnNetwork' does not exist.*argument network"):
        load_detector(tmp_path / "run")
    with pytest.raises(GraycastError, match=r"network is .*: give a subclass of Network or None"):
        graycast.load_detector(tmp_path / "run", network=again.network)


def test_a_former_name_of_a_network_names_the_example_that_replaces_it(capsys):
    with pytest.raises(GraycastError, match=r"^rf-detr is .* with examples/09_own_detector\.py"):
        network_class("rf-detr")
    with pytest.raises(SystemExit):
        main(["detector", "train", "data", "--model", "rf-detr", "--out", "out"])
    message = capsys.readouterr().err
    assert "examples/09_own_detector.py" in message and "invalid choice" not in message


@pytest.mark.slow
def test_a_loss_of_nan_stops_the_training(dataset, tmp_path):
    with pytest.raises(GraycastError, match=r"the loss is not a number after \d+ steps: lower"):
        train([dataset], tmp_path / "run", replace(SMALL, learning_rate=1e30, epochs=20))


@pytest.mark.slow
def test_a_damaged_checkpoint_or_detector_is_named(dataset, tmp_path):
    run = tmp_path / "run"
    train([dataset], run, SMALL)
    content = (run / "detector.pt").read_bytes()
    (run / "detector.pt").write_bytes(content[: len(content) // 2])
    with pytest.raises(GraycastError, match=r"detector.pt: is damaged or is not a detector"):
        load_detector(run)
    (run / "checkpoint.pt").write_bytes(b"")
    with pytest.raises(GraycastError, match=r"checkpoint\.pt: is damaged: remove it"):
        train([dataset], run, SMALL)
    with pytest.raises(
        GraycastError, match="does not exist: give a folder that graycast detector train wrote"
    ):
        load_detector(tmp_path / "nowhere")


@pytest.mark.slow
def test_weights_that_do_not_fit_the_network_are_refused(run, tmp_path):
    checkpoint = torch.load(run / "detector.pt", weights_only=True)
    checkpoint["state"] = {f"renamed.{name}": value for name, value in checkpoint["state"].items()}
    torch.save(checkpoint, tmp_path / "detector.pt")
    with pytest.raises(GraycastError, match="weights do not fit the network yolov3 of this"):
        load_detector(tmp_path)


def test_a_file_for_encoded_pictures_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("graycast.learn.detect.training_pictures.os.posix_fallocate", full)
    with pytest.raises(GraycastError, match=r"a\.npy: cannot be written \(No space left"):
        room_for(tmp_path / "a.npy", (1, 3, 32, 32))


@pytest.fixture(scope="module")
def run(dataset, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "run"
    with no_pixels():
        train([dataset], folder, replace(SMALL, epochs=1))
    return folder


@pytest.mark.slow
def test_impossible_inputs_of_detection_are_refused_in_one_line(dataset, run, tmp_path, capsys):
    def message(*arguments, data=dataset, out=tmp_path / "found"):
        return refusal(capsys, "detector", "find", run, data, "--out", out, *arguments)

    (tmp_path / "empty").mkdir()
    assert "has no pictures: put them into the folders" in message(data=tmp_path / "empty")
    assert "is not a dataset, so it has no set test" in message("--split", "test", data=tmp_path)
    assert "has no set 'test'" in message("--split", "test")
    assert "--device optix applies only to Cycles" in message("--device", "optix")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("mine")
    assert "is not empty and holds no earlier result" in message(out=tmp_path / "mine")
    if not torch.cuda.is_available():
        assert "torch finds no NVIDIA GPU: use --device cpu, or repair the driver" in message(
            "--device", "cuda"
        )
    assert not (tmp_path / "found").exists()


@pytest.mark.slow
def test_depth_of_another_unit_is_refused_and_filled_holes_are_noted(
    dataset, run, tmp_path, capsys
):
    """The scale is known from the dataset: no camera is ten times as far away."""
    shots = tmp_path / "shots"
    (shots / "depth").mkdir(parents=True)
    scene = dataset / "train" / "000000"
    scale_m = json.loads((scene / "scene_camera_sl.json").read_bytes())["0"]["depth_scale"] / 1e3
    steps = cv2.imread(str(scene / "depth_sl" / "000000.png"), cv2.IMREAD_UNCHANGED)
    noise = np.random.default_rng(0).normal(0.0, 1e-3 / scale_m, steps.shape)  # The drawing is flat
    steps = np.where(steps > 0, steps + noise, 0).astype(np.uint16)

    def find(scale_m):
        cv2.imwrite(str(shots / "depth" / "a.png"), steps)
        arguments = (
            "detector",
            "find",
            run,
            shots,
            "--scale",
            scale_m,
            "--out",
            tmp_path / "found",
        )
        return main([str(word) for word in arguments]), capsys.readouterr()

    for factor in (10, 0.1):
        code, output = find(factor * scale_m)
        assert code == 1 and output.err.count("\n") == 1
        assert "and the detector learnt" in output.err and "another unit" in output.err
    code, output = find(scale_m)
    assert code == 0 and "note:" not in output.out
    steps[::2, ::2] = steps.max()
    code, output = find(scale_m)
    assert code == 0 and "note: scene 0: " in output.out and "holes that were filled" in output.out


def test_a_dataset_with_other_parts_is_refused(run, tmp_path, capsys):
    other = write_shapes(tmp_path, 2)
    for name in ("graycast.json", "train_coco.json"):
        text = (other / name).read_text()
        (other / name).write_text(text.replace('"disc"', '"nut"').replace('"box"', '"bolt"'))
    message = refusal(capsys, "detector", "find", run, other, "--out", tmp_path / "found")
    assert "has nut, bolt, and the detector was trained on disc, box" in message


@pytest.mark.slow
def test_a_picture_that_is_cut_off_is_named(run, tmp_path, capsys):
    broken = write_shapes(tmp_path, 6, seed=9)
    picture = next((broken / "train").glob("000003/depth_sl/*.png"))
    picture.write_bytes(picture.read_bytes()[:200])
    options = f"{SMALL_NETWORK} --shares 0.7,0.3,0".split()
    for arguments in (("find", run, broken), ("train", broken, *options)):
        message = refusal(capsys, "detector", *arguments, "--out", tmp_path / f"out_{arguments[0]}")
        assert "000003" in message and "depth_sl" in message


def test_a_full_disk_is_reported_before_the_training(dataset, tmp_path, monkeypatch):
    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr(
        "graycast.learn.detect.training_pictures.shutil.disk_usage", lambda _: usage
    )
    with pytest.raises(GraycastError, match=r"0\.0 GB free and the encoded pictures take"):
        train([dataset], tmp_path / "run", SMALL)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"epochs": 0}, "epochs is 0: give a whole number of at least 1"),
        ({"batch": 0}, "batch is 0"),
        ({"learning_rate": 0.0}, "learning_rate is 0"),
        ({"model": "yolov9"}, "model 'yolov9' does not exist: choose one of mask-rcnn"),
        ({"input": "xray"}, "input is 'xray': choose one of rgb"),
        ({"holes": "none"}, "holes is 'none': choose one of channel"),
        ({"range_m": (2.0, 1.0)}, "the depth's range is 2.0 to 1.0 m"),
    ],
)
def test_an_impossible_setting_is_refused(dataset, tmp_path, changed, message):
    with pytest.raises(GraycastError, match=message):
        train([dataset], tmp_path / "run", replace(SMALL, **changed))
