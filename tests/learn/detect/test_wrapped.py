"""YOLOv7 behind our protocol gives the same results as its library called directly."""

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from .test_networks import opened, pictures, settled, total


@pytest.mark.slow
def test_the_loss_of_yolov7_equals_that_of_libreyolo():
    network = opened("yolov7").eval()
    images, targets = pictures()
    ours = total(network, images, targets)[1]
    from libreyolo.models.yolo7.loss import YOLOv7Loss

    anchors = [[12, 16, 19, 36, 40, 28], [36, 75, 76, 55, 72, 146], [142, 110, 192, 243, 459, 401]]
    scale = (64 * 96) ** 0.5 / 640
    criterion = YOLOv7Loss(2, [[s * scale for s in level] for level in anchors], [8, 16, 32])
    labels = torch.zeros(2, 4, 5)
    for row, target in zip(labels, targets, strict=True):
        for place, (box, label) in enumerate(zip(target.box, target.label, strict=True)):
            x0, y0, x1, y1 = box.tolist()
            row[place] = torch.tensor(
                [float(label), (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0]
            )
    theirs = criterion(network.network(images), labels)
    assert float(theirs["total_loss"].detach()) > 0
    for name, value in {"box": "iou_loss", "objectness": "obj_loss", "class": "cls_loss"}.items():
        torch.testing.assert_close(ours[name], theirs[value])
    torch.testing.assert_close(sum(ours.values()), theirs["total_loss"])


@pytest.mark.slow
def test_yolov7_detects_the_same_boxes_as_libreyolo():
    network = settled(opened("yolov7"))
    torch.manual_seed(4)
    for end in network.network.layers[-1].heads:  # Untrained heads score everything low.
        torch.nn.init.normal_(end.head_conv.weight, std=0.1)
        torch.nn.init.uniform_(end.head_conv.bias, -1, 1)
    images, _ = pictures()
    from libreyolo.postprocess.yolo7 import postprocess

    with torch.no_grad():
        maps = network.network(images)
    for index, ours in enumerate(network.find(images, most=300, least_score=0.2)):
        theirs = postprocess(
            [m[index : index + 1] for m in maps],
            network.anchors_px,
            [8, 16, 32],
            2,
            conf_thres=0.2,
            original_size=(96, 64),
            input_size=(64, 96),
        )
        assert theirs["num_detections"] >= 5
        assert len(ours.score) == theirs["num_detections"]
        torch.testing.assert_close(ours.score, torch.tensor(theirs["scores"]))
        # Equal scores have no fixed order, so each row must occur in the other result.
        bare = [torch.tensor(theirs[name]) for name in ("boxes", "classes", "scores")]
        rows = [
            torch.cat([box, label[:, None], score[:, None]], dim=1)
            for box, label, score in ((ours.box, ours.label, ours.score), bare)
        ]
        apart = torch.cdist(*rows, compute_mode="donot_use_mm_for_euclid_dist")
        assert apart.amin(dim=0).max() < 1e-4 and apart.amin(dim=1).max() < 1e-4


@pytest.mark.slow
def test_yolov7_anchors_equal_the_published_anchors_at_the_published_size():
    network = opened("yolov7", size_px=(640, 640))
    assert network.anchors_px[0] == [12, 16, 19, 36, 40, 28]
