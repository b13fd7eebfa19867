"""YOLOv7 and RF-DETR behind our protocol beside their libraries called bare."""

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from .test_networks import opened, pictures, settled, total

# rfdetr imports libraries that warn of what they will stop to offer.
pytestmark = [
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ImportWarning"),
]


def test_yolov7_has_the_loss_of_libreyolo():
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


def test_yolov7_finds_the_boxes_of_libreyolo():
    network = settled(opened("yolov7"))
    torch.manual_seed(4)
    for end in network.network.layers[-1].heads:  # fresh ones score everything low
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
        # Equal scores stand in any order: each row of one is a row of the other.
        bare = [torch.tensor(theirs[name]) for name in ("boxes", "classes", "scores")]
        rows = [
            torch.cat([box, label[:, None], score[:, None]], dim=1)
            for box, label, score in ((ours.box, ours.label, ours.score), bare)
        ]
        apart = torch.cdist(*rows, compute_mode="donot_use_mm_for_euclid_dist")
        assert apart.amin(dim=0).max() < 1e-4 and apart.amin(dim=1).max() < 1e-4


def test_yolov7_anchors_are_the_published_ones_at_the_published_size():
    network = opened("yolov7", size_px=(640, 640))
    assert network.anchors_px[0] == [12, 16, 19, 36, 40, 28]


def bare_answer(network, images, targets):
    """rfdetr's network and criterion, its weighted losses summed by us."""
    labels = []
    for target in targets:
        x0, y0, x1, y1 = (target.box / torch.tensor([96.0, 64, 96, 64])).unbind(1)
        boxes = torch.stack([(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0], dim=1)
        labels.append({"labels": target.label, "boxes": boxes})
    losses = network.criterion(network.network(images), labels)
    return losses, network.criterion.weight_dict


@pytest.mark.parametrize("training", [True, False])
def test_rf_detr_has_the_loss_of_rfdetr(training):
    network = opened("rf-detr").train(training)
    images, targets = pictures()
    value, ours = total(network, images, targets)
    torch.manual_seed(0)
    losses, weights = bare_answer(network, images, targets)
    torch.testing.assert_close(value, sum(losses[name] * weights[name] for name in weights))
    layers = ("", "_0", "_enc")
    torch.testing.assert_close(ours["box"], sum(5 * losses[f"loss_bbox{n}"] for n in layers))


def test_rf_detr_finds_the_boxes_of_rfdetr():
    network = opened("rf-detr").eval()
    images, _ = pictures()
    from rfdetr.models.postprocess import PostProcess

    with torch.no_grad():
        theirs = PostProcess(num_select=300)(network.network(images), torch.tensor([[64, 96]] * 2))
    for ours, bare in zip(network.find(images, most=300, least_score=0.0), theirs, strict=True):
        assert len(ours.score) == 2 * 24  # either class of a query for each patch of 16 px
        assert torch.equal(ours.label, bare["labels"])
        torch.testing.assert_close(ours.score, bare["scores"])
        torch.testing.assert_close(ours.box, bare["boxes"])


@pytest.mark.parametrize(("size_px", "queries"), [((64, 96), 24), ((320, 320), 300)])
def test_every_query_of_rf_detr_has_a_patch_to_start_from(size_px, queries):
    """Else its groups of queries get each other's patches in training, and learn nothing."""
    network = opened("rf-detr", size_px=size_px).network
    assert network.num_queries == network.transformer.num_queries == queries


def test_a_query_of_rf_detr_that_means_an_ignored_instance_is_not_told_off():
    """Oracle: without any other instance the matching is empty, so the loss of the classes is a
    sum over queries, and must fall by just what the silent ones had in it."""
    network = opened("rf-detr").eval()
    images, targets = pictures()
    with torch.no_grad():
        x, y, w, h = network.network(images)["pred_boxes"][0, 0] * torch.tensor([96, 64, 96, 64.0])
    box = torch.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2])[None]
    hidden = replace(
        targets[0], box=box, label=targets[0].label[:1], mask=None, ignored=torch.tensor([True])
    )
    nothing = replace(
        hidden,
        box=hidden.box[:0],
        label=hidden.label[:0],
        ignored=hidden.ignored[:0],
    )
    ignored, alone = (total(network, images[:1], [t])[1] for t in (hidden, nothing))
    assert float(ignored["class"].detach()) < float(alone["class"].detach())
    assert float(ignored["box"].detach()) == float(alone["box"].detach()) == 0.0
