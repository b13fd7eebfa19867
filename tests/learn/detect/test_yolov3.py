"""YOLOv3's anchors; the rest of it is beside mmdetection in `test_parity.py`."""

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from graycast.learn.detect.yolov3 import Yolov3


@pytest.mark.parametrize(
    ("size_px", "scale"), [((416, 416), 1), ((208, 832), 1), ((64, 169), 0.25)]
)
def test_anchors_grow_with_the_picture(size_px, scale):
    """Oracle: the paper's, at the 416 pixels that they are for (its section 2.3, reversed)."""
    network = Yolov3(channels=1, classes=1, backbone="mobilenet-v3-small", size_px=size_px)
    paper = [[116, 90], [156, 198], [373, 326], [30, 61], [62, 45], [59, 119], [10, 13], [16, 30]]
    expected = scale * torch.tensor([*paper, [33, 23]], dtype=torch.float32)
    torch.testing.assert_close(network.anchor_px.reshape(-1, 2), expected)
