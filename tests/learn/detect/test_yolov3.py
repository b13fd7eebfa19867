"""Test YOLOv3's anchors and box suppression; `test_parity.py` tests the rest."""

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from graycast.learn.detect.suppression import best_boxes
from graycast.learn.detect.yolov3 import Yolov3


@pytest.mark.parametrize(
    ("size_px", "scale"), [((416, 416), 1), ((208, 832), 1), ((64, 169), 0.25)]
)
def test_anchors_grow_with_the_picture(size_px, scale):
    """Oracle: the paper's anchors, which are for 416 pixels (its section 2.3, in reverse order)."""
    network = Yolov3(channels=1, classes=1, backbone="mobilenet-v3-small", size_px=size_px)
    paper = [[116, 90], [156, 198], [373, 326], [30, 61], [62, 45], [59, 119], [10, 13], [16, 30]]
    expected = scale * torch.tensor([*paper, [33, 23]], dtype=torch.float32)
    torch.testing.assert_close(network.anchor_px.reshape(-1, 2), expected)


def test_only_the_best_of_overlapping_boxes_is_kept_and_cut_at_the_border():
    """The second box overlaps the first by 121 / 225, above the limit of 0.45, the third by
    100 / 225. The fourth extends beyond the picture of 100 x 50 pixels."""
    box = [[-5, -5, 10, 10], [-1, -1, 10, 10], [0, 0, 10, 10], [40, 20, 120, 70]]
    score = [[0.9, 0.0], [0.8, 0.3], [0.7, 0.0], [0.6, 0.1]]
    output = best_boxes(
        torch.tensor(box, dtype=torch.float32), torch.tensor(score),
        most=4, least_score=0.2, size_px=(50, 100),
    )  # fmt: skip
    torch.testing.assert_close(output.score, torch.tensor([0.9, 0.7, 0.6, 0.3]))
    assert output.label.tolist() == [0, 0, 0, 1]
    expected = [[0, 0, 10, 10], [0, 0, 10, 10], [40, 20, 100, 50], [0, 0, 10, 10]]
    assert output.box.tolist() == expected
