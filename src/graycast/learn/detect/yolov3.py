"""YOLOv3: boxes by regression from anchors at three scales.

Source: Redmon & Farhadi, "YOLOv3: An Incremental Improvement", 2018. Details that the paper does
not state (negative anchors, weights of the terms) are as in mmdetection 3.3: a slow test shows that
equal weights give equal losses and boxes. Two differences are intended: losses are means over the
pictures of a batch, where mmdetection has sums, and boxes end at the picture's edge.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import final

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, interpolate
from torchvision.ops import box_iou

from .backbones import Convolution, open_backbone
from .network import Network, NetworkOutput, Recipe, Target
from .suppression import best_boxes

# These widths and heights are in pixels of a picture of 416 x 416, from the coarsest scale to the
# finest. The paper clustered them from COCO, and they scale with the picture.
ANCHORS_416_PX = (
    ((116, 90), (156, 198), (373, 326)),
    ((30, 61), (62, 45), (59, 119)),
    ((10, 13), (16, 30), (33, 23)),
)
STRIDES = (32, 16, 8)
OVERLAP = 0.5  # An anchor that overlaps an instance by more than this is not a negative.
CENTRE_WEIGHT, SIZE_WEIGHT = 2.0, 2.0
MOST_LOG_GROWTH = 8.0  # A box of e^8 anchors is larger than any picture; more would overflow.
LEAST_SHARE = 1e-6  # least share of a cell or an anchor, because zero has no logarithm


@final
class Yolov3(Network):
    """A network that finds boxes, with the paper's neck for wide backbones, else a narrow one."""

    finds_masks = False
    recipe = Recipe(learning_rate=1e-3, batch=8, weight_decay=0.01)

    def __init__(
        self, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
    ) -> None:
        super().__init__()
        self.classes = classes
        self.body = open_backbone(backbone or "mobilenet-v2", channels=channels)
        wide = self.body.name in ("darknet53", "resnet50")
        self.neck = _Neck(self.body.channels[:0:-1], (512, 256, 128) if wide else (96, 96, 96))
        self.ends = nn.ModuleList(
            _End(width, 2 * width if wide else width, len(ANCHORS_416_PX[0]) * (5 + classes))
            for width in self.neck.widths
        )
        scale = (size_px[0] * size_px[1]) ** 0.5 / 416
        anchor_px = torch.tensor(ANCHORS_416_PX, dtype=torch.float32) * scale
        self.register_buffer("anchor_px", anchor_px, persistent=False)
        with torch.no_grad():  # Objectness starts at 0.01: most anchors are empty.
            for end in self.ends:
                end.last.weight.normal_(std=0.01)
                end.last.bias.zero_()
                end.last.bias.view(-1, 5 + classes)[:, 4] = -4.6

    def forward(self, image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b anchors values"]:
        """Return each anchor's raw output: centre (logits), log of size, objectness, classes."""
        maps = self.neck(self.body(image)[:0:-1])
        answers = [end(m) for end, m in zip(self.ends, maps, strict=True)]
        values = 5 + self.classes
        flat = [a.permute(0, 2, 3, 1).reshape(len(image), -1, values) for a in answers]
        return torch.cat(flat, dim=1).float()

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Return the terms of the loss, each as the mean over the pictures."""
        raw = self(image)
        anchor, stride = self._anchors(image)
        terms = [_terms(r, anchor, stride, t) for r, t in zip(raw, targets, strict=True)]
        return {name: torch.stack([t[name] for t in terms]).mean() for name in terms[0]}

    @torch.no_grad()
    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Return boxes of all scales after non-maximum suppression."""
        raw = self(image)
        anchor, stride = self._anchors(image)
        height, width = image.shape[-2:]
        return [
            best_boxes(
                _decode(answer, anchor, stride),
                answer[:, 4:5].sigmoid() * answer[:, 5:].sigmoid(),
                most=most,
                least_score=least_score,
                size_px=(height, width),
            )
            for answer in raw
        ]

    def _anchors(
        self, image: Float[Tensor, "b c h w"]
    ) -> tuple[Float[Tensor, "anchors 4"], Float[Tensor, " anchors"]]:
        """Return the anchors as boxes, and the sides of their cells, in the order of `forward`."""
        boxes, strides = [], []
        for stride, size in zip(STRIDES, self.anchor_px, strict=True):
            rows, columns = (
                (torch.arange(side // stride, device=image.device) + 0.5) * stride
                for side in image.shape[-2:]
            )
            y, x = torch.meshgrid(rows, columns, indexing="ij")
            centre = torch.stack([x, y], dim=-1)[:, :, None]  # (h, w, 1, 2)
            box = torch.cat([centre - size / 2, centre + size / 2], dim=-1).reshape(-1, 4)
            boxes.append(box)
            strides.append(box.new_full((len(box),), stride))
        return torch.cat(boxes), torch.cat(strides)


@final
class _Neck(nn.Module):
    """A feature pyramid from the coarsest map down; upsampled maps are joined to finer ones."""

    def __init__(self, inside: tuple[int, ...], widths: tuple[int, ...]) -> None:
        super().__init__()
        self.widths = widths
        above = (0, *widths[1:])
        self.blocks = nn.ModuleList(
            _block(i + a, w) for i, a, w in zip(inside, above, widths, strict=True)
        )
        self.bridges = nn.ModuleList(Convolution(a, b, 1) for a, b in pairwise(widths))

    def forward(self, maps: Sequence[Tensor]) -> list[Tensor]:
        out = [self.blocks[0](maps[0])]
        for block, bridge, finer in zip(self.blocks[1:], self.bridges, maps[1:], strict=True):
            out.append(block(torch.cat([interpolate(bridge(out[-1]), scale_factor=2), finer], 1)))
        return out


def _block(inside: int, width: int) -> nn.Sequential:
    """Return five convolutions, which are narrow and wide in turn."""
    return nn.Sequential(
        Convolution(inside, width, 1),
        Convolution(width, 2 * width, 3),
        Convolution(2 * width, width, 1),
        Convolution(width, 2 * width, 3),
        Convolution(2 * width, width, 1),
    )


@final
class _End(nn.Module):
    def __init__(self, inside: int, width: int, outside: int) -> None:
        super().__init__()
        self.first = Convolution(inside, width, 3)
        self.last = nn.Conv2d(width, outside, 1)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        return self.last(self.first(x))


def _terms(
    raw: Float[Tensor, "anchors values"],
    anchor: Float[Tensor, "anchors 4"],
    stride: Float[Tensor, " anchors"],
    target: Target,
) -> dict[str, Tensor]:
    """Return the loss terms of one picture; anchors neither positive nor negative do not count."""
    owner, negative = assign(anchor, stride, target)
    positive = owner >= 0
    mine, box = raw[positive], target.box[owner[positive]]
    centre, size = _encode(box, anchor[positive], stride[positive])
    label = nn.functional.one_hot(target.label[owner[positive]], raw.shape[1] - 5)
    counts = positive | negative
    return {
        "centre": CENTRE_WEIGHT * _cross_entropy(mine[:, :2], centre),
        "size": SIZE_WEIGHT * (mine[:, 2:4] - size).square().sum(),
        "objectness": _cross_entropy(raw[counts, 4], positive[counts].float()),
        "class": _cross_entropy(mine[:, 5:], label.float()),
    }


def _cross_entropy(logit: Float[Tensor, "..."], truth: Float[Tensor, "..."]) -> Float[Tensor, ""]:
    return binary_cross_entropy_with_logits(logit, truth, reduction="sum")


def assign(
    anchor: Float[Tensor, "anchors 4"], stride: Float[Tensor, " anchors"], target: Target
) -> tuple[Int64[Tensor, " anchors"], Bool[Tensor, " anchors"]]:
    """Assign anchors to instances, and determine the negative anchors.

    An instance owns the anchors in the cell of its centre whose overlap with it exceeds `OVERLAP`,
    and always the anchor with the largest overlap. An ignored instance owns none, but the anchors
    that it would own, and those whose overlap exceeds `OVERLAP`, are not negative.

    Returns:
        The index of each anchor's instance, -1 for none; and whether each anchor is negative.
    """
    overlap = box_iou(anchor, target.box)
    centre = (target.box[:, :2] + target.box[:, 2:]) / 2
    cell = ((anchor[:, :2] + anchor[:, 2:]) / 2 / stride[:, None]).floor()
    at_centre = ((centre / stride[:, None, None]).floor() == cell[:, None]).all(dim=-1)
    owner, would_own = (
        _owners(overlap, at_centre, kind) for kind in (~target.ignored, target.ignored)
    )
    far = (overlap <= OVERLAP).all(dim=1)
    return owner, far & (owner < 0) & (would_own < 0)


def _owners(
    overlap: Float[Tensor, "anchors n"],
    at_centre: Bool[Tensor, "anchors n"],
    kind: Bool[Tensor, " n"],
) -> Int64[Tensor, " anchors"]:
    """Return which instance of a kind owns each anchor: the last one if several do, -1 if none."""
    nobody = torch.full((len(overlap),), -1, device=overlap.device)
    if not kind.any():
        return nobody
    cell = at_centre[:, kind].any(dim=1)
    overlap = overlap.where(cell[:, None] & kind, -1.0)
    best, nearest = overlap.max(dim=1)
    owner = nearest.where(best > OVERLAP, nobody)
    is_best = (overlap == overlap.amax(dim=0)) & (overlap > 0)
    index = torch.arange(len(kind), device=overlap.device)
    last = index.where(is_best, -1).amax(dim=1)
    return last.where(last >= 0, owner)


def _encode(
    box: Float[Tensor, "n 4"], anchor: Float[Tensor, "n 4"], stride: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 2"], Float[Tensor, "n 2"]]:
    """Return each centre's position in its cell, from 0 to 1, and the log of the size ratio."""
    away = (box[:, :2] + box[:, 2:] - anchor[:, :2] - anchor[:, 2:]) / 2
    centre = (away / stride[:, None] + 0.5).clamp(LEAST_SHARE, 1 - LEAST_SHARE)
    growth = (box[:, 2:] - box[:, :2]) / (anchor[:, 2:] - anchor[:, :2])
    return centre, growth.clamp(min=LEAST_SHARE).log()


def _decode(
    raw: Float[Tensor, "n values"], anchor: Float[Tensor, "n 4"], stride: Float[Tensor, " n"]
) -> Float[Tensor, "n 4"]:
    """Return boxes in pixels; this is the inverse of `_encode`."""
    away = (raw[:, :2].sigmoid() - 0.5) * stride[:, None]
    centre = (anchor[:, :2] + anchor[:, 2:]) / 2 + away
    half = (anchor[:, 2:] - anchor[:, :2]) / 2 * raw[:, 2:4].clamp(max=MOST_LOG_GROWTH).exp()
    return torch.cat([centre - half, centre + half], dim=1)
