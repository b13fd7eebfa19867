"""YOLOv7: boxes by the network and the loss of libreyolo (MIT).

The network of libreyolo is from the authors' MIT release (MultimediaTechLab/YOLO), and its loss is
from YOLOX (Apache-2.0); neither uses the original yolov7 repository, which is GPL. Graycast adds
any number of channels, anchors that scale with the picture, and ignored instances.

Source: Wang, Bochkovskiy & Liao, "YOLOv7: Trainable bag-of-freebies sets new state-of-the-art for
real-time object detectors", CVPR 2023; assignment: Ge et al., "YOLOX", 2021 (SimOTA).
"""

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torchvision.ops import box_convert

from ...base.errors import GraycastError
from .backbones import follow_fast
from .network import Network, NetworkOutput, Recipe, Target
from .suppression import best_boxes

PUBLISHED_PX = 640  # The library's anchors are for pictures of this side.
# Only cells within this many cells of an instance's centre, along both axes, may own the instance.
REACH = 1.5
# In single precision, this logit has no cross-entropy with the label "no object".
SILENT = -100.0


@final
class Yolov7(Network):
    """A network that finds boxes. It has only its own backbone."""

    finds_masks = False
    recipe = Recipe(learning_rate=1e-3, batch=8, weight_decay=0.01)

    def __init__(
        self, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
    ) -> None:
        super().__init__()
        if backbone is not None:
            raise GraycastError(
                f"model yolov7 has a backbone of its own: remove --backbone {backbone}"
            )
        try:
            from libreyolo.models.yolo7.loss import YOLOv7Loss
            from libreyolo.models.yolo7.net import YOLOv7Model
            from libreyolo.postprocess.yolo7 import decode_v7_head
        except ImportError as error:
            raise GraycastError(
                f"model yolov7 needs libreyolo ({error}): run pip install --no-deps "
                "'libreyolo>=1.6'"
            ) from error
        self.classes = classes
        self.network = YOLOv7Model(num_classes=classes)
        first = self.network.layers[0].conv
        if channels != first.in_channels:
            self.network.layers[0].conv = nn.Conv2d(
                channels, first.out_channels, first.kernel_size, padding=first.padding, bias=False
            )
        self.network.initialize_biases()
        follow_fast(self.network)
        scale = (size_px[0] * size_px[1]) ** 0.5 / PUBLISHED_PX
        self.anchors_px = [[side * scale for side in level] for level in self.network.anchors]
        self.strides = tuple(self.network.strides)
        self._criterion = YOLOv7Loss(
            classes, self.anchors_px, self.strides, distributed_normalize=False
        )
        self._decode = decode_v7_head

    def forward(self, image: Float[Tensor, "b c h w"]) -> list[Tensor]:
        """Return the library's raw output maps, from the finest to the coarsest."""
        return self.network(image)

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Return the terms of the library's loss, per anchor that owns an instance."""
        maps = [
            self._without_ignored(m, targets, stride)
            for m, stride in zip(self(image), self.strides, strict=True)
        ]
        terms = self._criterion(maps, _padded(targets, image))
        return {
            "box": terms["iou_loss"],
            "objectness": terms["obj_loss"],
            "class": terms["cls_loss"],
        }

    @torch.no_grad()
    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Return boxes of all scales after suppression, each with its best class only."""
        maps = self(image)
        height, width = image.shape[-2:]
        limit = image.new_tensor([width, height, width, height], dtype=torch.float32)
        outputs = []
        for index in range(len(image)):
            levels = [
                self._decode(
                    m[index : index + 1].float(),
                    list(zip(anchors[::2], anchors[1::2], strict=True)),
                    stride,
                    self.classes,
                )
                for m, anchors, stride in zip(maps, self.anchors_px, self.strides, strict=True)
            ]
            box, score = (torch.cat(parts) for parts in zip(*levels, strict=True))
            corners = box_convert(box, "cxcywh", "xyxy").clamp(min=0).minimum(limit)
            best = score * (score == score.amax(dim=1, keepdim=True))
            inside = (corners[:, 2:] > corners[:, :2]).all(dim=1)
            outputs.append(
                best_boxes(
                    corners[inside],
                    best[inside],
                    most=most,
                    least_score=least_score,
                    size_px=(height, width),
                )
            )
        return outputs

    def _without_ignored(
        self, raw: Float[Tensor, "b values h w"], targets: Sequence[Target], stride: int
    ) -> Float[Tensor, "b values h w"]:
        """Return the map without objectness in cells that only an ignored instance could own."""
        free = torch.stack([_only_ignored(t, stride, raw.shape[-2:]) for t in targets])
        if not free.any():
            return raw
        is_objectness = torch.arange(raw.shape[1], device=raw.device) % (5 + self.classes) == 4
        return raw.masked_fill(free[:, None] & is_objectness[:, None, None], SILENT)


def _only_ignored(target: Target, stride: int, size: tuple[int, int]) -> Bool[Tensor, "h w"]:
    """Return a mask of the cells within reach of ignored instances only."""
    row, column = ((torch.arange(n, device=target.box.device) + 0.5) * stride for n in size)
    centre = (target.box[:, :2] + target.box[:, 2:]) / 2
    near = [
        (c - centre[:, axis, None]).abs() < REACH * stride for axis, c in ((1, row), (0, column))
    ]
    reached = near[0][:, :, None] & near[1][:, None, :]  # (n, h, w)
    return reached[target.ignored].any(dim=0) & ~reached[~target.ignored].any(dim=0)


def _padded(targets: Sequence[Target], image: Tensor) -> Float[Tensor, "b n 5"]:
    """Return the library's labels: class, centre and size of counted instances, padded with 0."""
    longest = max([int((~t.ignored).sum()) for t in targets], default=0)
    rows = image.new_zeros(len(targets), max(longest, 1), 5, dtype=torch.float32)
    for row, target in zip(rows, targets, strict=True):
        box, label = target.box[~target.ignored], target.label[~target.ignored]
        row[: len(box), 0] = label
        row[: len(box), 1:3] = (box[:, :2] + box[:, 2:]) / 2
        row[: len(box), 3:5] = box[:, 2:] - box[:, :2]
    return rows
