"""Detectors as ONNX files: onnxruntime finds what torch finds, or there is no file."""

import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")
onnx = pytest.importorskip("onnx", reason="needs onnx: pip install 'graycast[detect]'")

from graycast.base.errors import GraycastError
from graycast.learn.detect.detector import About, Detector
from graycast.learn.detect.encoding import Encoding
from graycast.learn.detect.onnx_file import _compare


def detector(model):
    encoding = Encoding(input="depth_sl", size_px=(96, 128), near_m=0.5, far_m=1.0)
    about = About(
        model=model,
        backbone="mobilenet-v3-small",
        encoding=encoding,
        names=("nut", "bolt"),
        trained={},
    )
    torch.manual_seed(1)
    network = about.open_network().eval()
    return Detector(about=about, network=network, device=torch.device("cpu"))


# This runs in its own process, as type checks at every call would be traced with the network.
CHECK = """
import json, sys, numpy, onnx, onnxruntime, torch
sys.path.insert(0, sys.argv[1])
from learn.detect.test_onnx import detector
from graycast.learn.detect.onnx_file import write_onnx

made = detector(sys.argv[2])
write_onnx(made, __import__("pathlib").Path(sys.argv[3]), most=20, least_score=0.0)
held = {entry.key: entry.value for entry in onnx.load(sys.argv[3]).metadata_props}
assert json.loads(held["graycast"])["names"] == ["nut", "bolt"]
session = onnxruntime.InferenceSession(sys.argv[3])
for image in (torch.randn(1, 3, 96, 128), torch.zeros(1, 3, 96, 128)):
    with torch.no_grad():
        found = made.network.find(image, most=20, least_score=0.0)[0]
    score = session.run(["score"], {"image": image.numpy()})[0]
    numpy.testing.assert_allclose(numpy.sort(score), numpy.sort(found.score.numpy()), atol=1e-4)
"""


@pytest.mark.slow
@pytest.mark.parametrize("model", ["mask-rcnn", "yolov3"])
def test_onnxruntime_and_torch_detect_the_same_parts_in_new_pictures(tmp_path, model):
    tests = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-W", "ignore", "-c", CHECK, str(tests), model]
    subprocess.run([*command, str(tmp_path / "detector.onnx")], check=True)


class Session:
    """A substitute for onnxruntime's session that returns the given outputs."""

    def __init__(self, *outputs):
        self.outputs = outputs

    def run(self, names, fed):
        return self.outputs


@pytest.mark.parametrize(
    ("moved_px", "dimmed", "agrees"), [(0.0, 0.0, True), (1.0, 0.0, False), (0.0, 0.01, False)]
)
def test_an_onnx_file_with_different_detections_is_refused(moved_px, dimmed, agrees):
    box = torch.tensor([[0.0, 0.0, 9.0, 9.0], [20.0, 20.0, 40.0, 30.0]])
    label, score = torch.tensor([0, 1]), torch.tensor([0.9, 0.4])
    session = Session(box.numpy() + moved_px, label.numpy(), score.numpy() - dimmed)
    known = lambda image: (box, label, score)  # noqa: E731
    if agrees:
        _compare(session, known, torch.zeros(1))
        return
    with pytest.raises(GraycastError, match="onnxruntime finds other detections than torch"):
        _compare(session, known, torch.zeros(1))
