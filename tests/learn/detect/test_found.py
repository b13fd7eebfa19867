"""Test detections that are converted from the network's input to the picture's pixels."""

import numpy as np
import pytest
from pycocotools import mask as coco_mask

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from graycast.dataset.read.detections import Detections
from graycast.dataset.read.example import Example
from graycast.learn.detect.detecting import PictureSelection, detect
from graycast.learn.detect.detector import About, Detector, _detections
from graycast.learn.detect.encoding import Encoding
from graycast.learn.detect.network import NetworkOutput

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@pytest.mark.parametrize("times", [1, 2])  # Larger factors round the corners.
def test_boxes_and_outlines_are_scaled_with_the_picture(times):
    """A picture of `times` 40 x 30 pixels gives an input of 40 x 30; edges are between pixels."""
    mask = torch.zeros(2, 30, 40, dtype=torch.uint8)
    mask[0, 5:15, 10:30], mask[1, 0:10, 30:40] = 255, 255
    output = NetworkOutput(
        box=torch.tensor([[10.0, 5, 30, 15], [30, -2, 45, 10]]), label=torch.tensor([1, 0]),
        score=torch.tensor([0.5, 0.9]), mask=mask,
    )  # fmt: skip
    picture_px = 30 * times, 40 * times
    detections = _detections(output, 7, np.array([11, 12]), picture_px, 1 / times)
    assert detections.obj_id.tolist() == [11, 12] and detections.score.tolist() == pytest.approx(
        [0.9, 0.5]
    )
    expected = np.array([[30, 0, 10, 10], [10, 5, 20, 10]]) * times  # cut at the picture's edges
    np.testing.assert_array_equal(detections.box_px, expected)
    for run, (x, y, columns, rows) in zip(detections.mask, expected, strict=True):
        whole = np.zeros(picture_px, np.uint8)
        whole[y : y + rows, x : x + columns] = 1
        np.testing.assert_array_equal(coco_mask.decode(dict(run)), whole)


def one_detection(score):
    box_px = np.array([[1.0, 1, 4, 4]])
    return Detections(scene_id=0, score=np.array([score]), obj_id=np.array([1]), box_px=box_px)


@pytest.mark.parametrize(
    ("scores", "drawings", "bare"),
    [
        ((0.3, 0.49), 2, "2 of 2"),
        ((0.3, 0.9), 2, "1 of 2"),
        ((0.9, 0.3), 1, ""),
        ((0.5, 1.0), 2, ""),
    ],
)
def test_a_note_counts_the_drawings_whose_detections_all_have_too_low_a_score(
    monkeypatch, tmp_path, scores, drawings, bare
):
    """Only the first pictures are drawn; what was found in another picture does not count."""
    remaining = iter(scores)
    monkeypatch.setattr(Detector, "detect", lambda *_, **__: one_detection(next(remaining)))
    encoding = Encoding(input="rgb", size_px=(32, 32))
    about = About(model="", backbone=None, encoding=encoding, names=("a",), trained={})
    detector = Detector.__new__(Detector)  # This test needs no network.
    object.__setattr__(detector, "about", about)
    rgb = np.zeros((8, 8, 3), np.uint8)
    pictures = PictureSelection(
        examples=[Example(scene_id=i, rgb=rgb) for i in range(2)], scene_ids=(0, 1),
        class_ids={"a": 1}, record={},
    )  # fmt: skip
    notes = detect(detector, pictures, tmp_path / "found", drawings=drawings).notes
    words = "drawings show no outline: detections are drawn from a score of 0.5 on"
    assert notes == ((f"{bare} {words}",) if bare else ())
