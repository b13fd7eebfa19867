"""Compare YOLOv3 and SOLOv2 with mmdetection 3.3 on equal weights, pictures and labels."""

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from graycast.learn.detect.network import Target
from graycast.learn.detect.solov2 import Solov2
from graycast.learn.detect.yolov3 import Yolov3

from . import mmdet_models

HERE = Path(__file__).parent
ENVIRONMENT = HERE.parents[2] / "out" / "mmdet-3.3.0"
# These are added to the running environment. numpy 2 lacks names that mmdetection uses.
PACKAGES = (
    "mmdet==3.3.0",
    "mmcv-lite==2.2.0",
    "mmengine==0.10.7",
    "numpy==1.26.4",
    "addict==2.4.0",
    "yapf==0.43.0",
    "platformdirs==4.3.6",
    "termcolor==2.5.0",
    "terminaltables==3.1.10",
    "rich==13.9.4",
    "six==1.17.0",
    "shapely==2.2.0",
)
HEIGHT_PX, WIDTH_PX, CLASSES = 128, 160, 2
LEAST_SCORE, MOST = 0.02, 60
NETWORKS = {"yolov3": Yolov3, "solov2": Solov2}
# mmdetection's names for the terms of the loss
TERMS = {
    "yolov3": {
        "centre": "loss_xy",
        "size": "loss_wh",
        "objectness": "loss_conf",
        "class": "loss_cls",
    },
    "solov2": {"mask": "loss_mask", "class": "loss_cls"},
}


@pytest.fixture(scope="session")
def mmdet_python():
    """Return an interpreter with mmdetection and this environment's torch, built in `out/`."""
    python = ENVIRONMENT / "bin" / "python"
    ready = ENVIRONMENT / "ready"
    if ready.is_file():
        return python
    shutil.rmtree(ENVIRONMENT, ignore_errors=True)
    steps = (
        [sys.executable, "-m", "venv", ENVIRONMENT],
        [python, "-m", "pip", "install", "--quiet", "--no-deps", *PACKAGES],
    )
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True)
        if done.returncode:
            last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
            pytest.skip(f"no environment with mmdetection could be built: {last}")
    library = next((ENVIRONMENT / "lib").glob("python*")) / "site-packages"
    (library / "torch_from_here.pth").write_text(sysconfig.get_path("purelib") + "\n")
    ready.touch()
    return python


def ellipses(count, seed):
    """Return labels of one picture: ellipses that may overlap or extend beyond its edges."""
    draw = torch.Generator().manual_seed(seed)
    row, column = torch.meshgrid(torch.arange(HEIGHT_PX), torch.arange(WIDTH_PX), indexing="ij")
    masks = torch.zeros(count, HEIGHT_PX, WIDTH_PX, dtype=torch.bool)
    boxes = torch.zeros(count, 4)
    for index in range(count):
        x, y, a, b, turn = torch.rand(5, generator=draw).tolist()
        dx, dy = column - x * WIDTH_PX, row - y * HEIGHT_PX
        cos, sin = torch.tensor(3 * turn).cos(), torch.tensor(3 * turn).sin()
        across = ((dx * cos + dy * sin) / (4 + 30 * a)) ** 2
        masks[index] = across + ((dy * cos - dx * sin) / (4 + 30 * b)) ** 2 < 1
        rows, columns = masks[index].nonzero().T
        edges = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
        boxes[index] = torch.tensor([int(edge) for edge in edges])
    return {"box": boxes, "mask": masks, "label": torch.randint(CLASSES, (count,), generator=draw)}


@pytest.fixture(scope="session")
def answers(mmdet_python, tmp_path_factory):
    """Return each case and mmdetection's output for it, by model and backbone."""
    known = {}

    def ask(model, backbone):
        if (model, backbone) not in known:
            folder = tmp_path_factory.mktemp(model)
            side = (HEIGHT_PX * WIDTH_PX) ** 0.5
            config = getattr(mmdet_models, model)(
                backbone, classes=CLASSES, side=side, least=LEAST_SCORE, most=MOST
            )
            image = torch.rand(
                3, 3, HEIGHT_PX, WIDTH_PX, generator=torch.Generator().manual_seed(4)
            )
            labels = [ellipses(14, seed=1), ellipses(0, seed=2), ellipses(40, seed=3)]
            case = {"seed": 5, "config": config, "image": image, "labels": labels}
            torch.save(case, folder / "case.pt")
            command = [mmdet_python, HERE / "mmdet_alone.py", folder / "case.pt", folder / "out.pt"]
            done = subprocess.run(command, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
            known[model, backbone] = case, torch.load(folder / "out.pt")
        return known[model, backbone]

    return ask


def with_their_weights(model, backbone, state):
    network = NETWORKS[model](
        channels=3, classes=CLASSES, backbone=backbone, size_px=(HEIGHT_PX, WIDTH_PX)
    )
    renamed = mmdet_models.under_our_names(model, backbone, state, network.state_dict())
    network.load_state_dict(renamed)
    return network.eval()


def close(ours, theirs):
    """Allow 1e-4 of the largest value, because sums in another order round differently."""
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4 * float(theirs.abs().max()))


CASES = pytest.mark.parametrize(
    ("model", "backbone"),
    [
        ("yolov3", "darknet53"),
        ("yolov3", "mobilenet-v2"),
        ("solov2", "resnet18"),
        ("solov2", "resnet50"),
    ],
)


@pytest.mark.slow
@CASES
def test_feature_maps_equal_those_of_mmdetection(model, backbone, answers):
    case, answer = answers(model, backbone)
    with torch.no_grad():
        ours = with_their_weights(model, backbone, answer["state"])(case["image"])
    if model == "yolov3":
        (theirs,) = answer["raw"]
        flat = [m.permute(0, 2, 3, 1).reshape(3, -1, 5 + CLASSES) for m in theirs]
        close(ours, torch.cat(flat, dim=1))
    else:
        kernels, scores, painted = answer["raw"][0]
        close(ours[0], torch.cat([m.flatten(2) for m in scores], dim=2).transpose(1, 2))
        close(ours[1], torch.cat([m.flatten(2) for m in kernels], dim=2).transpose(1, 2))
        close(ours[2], painted)


@pytest.mark.slow
@CASES
def test_each_term_of_the_loss_equals_that_of_mmdetection(model, backbone, answers):
    case, answer = answers(model, backbone)
    network = with_their_weights(model, backbone, answer["state"])
    targets = [
        Target(**label, ignored=torch.zeros(len(label["box"]), dtype=torch.bool))
        for label in case["labels"]
    ]
    with torch.no_grad():
        ours = network.losses(case["image"], targets)
    pictures = len(targets) if model == "yolov3" else 1  # mmdetection adds them; we take the mean.
    assert set(ours) == set(TERMS[model])
    for name, value in ours.items():
        assert float(value) == pytest.approx(
            float(answer["losses"][TERMS[model][name]]) / pictures, rel=1e-4
        )


@pytest.mark.slow
@CASES
def test_detections_equal_those_of_mmdetection(model, backbone, answers):
    case, answer = answers(model, backbone)
    network = with_their_weights(model, backbone, answer["state"])
    limit = torch.tensor([WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX])
    outputs = network.find(case["image"], most=MOST, least_score=LEAST_SCORE)
    for ours, theirs in zip(outputs, answer["found"], strict=True):
        assert len(ours.score) == len(theirs["scores"]) >= 15
        torch.testing.assert_close(ours.score, theirs["scores"], rtol=1e-4, atol=0)
        assert torch.equal(ours.label, theirs["labels"])
        if model == "yolov3":
            edges = theirs["bboxes"].clamp(min=0).minimum(limit)
            torch.testing.assert_close(ours.box, edges, rtol=1e-4, atol=1e-3)
        else:
            unlike = (ours.mask > 127) != theirs["masks"]
            assert unlike.float().mean() < 1e-5  # Rounding decides pixels at one half.
