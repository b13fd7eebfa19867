"""SOLOv2: masks without boxes; each cell of a grid computes the kernel for its instance's mask.

Source: Wang, Zhang, Kong, Li & Shen, "SOLOv2: Dynamic and Fast Instance Segmentation", NeurIPS
2020. Details that the paper does not state are as in mmdetection 3.3: a slow test shows that equal
weights give equal losses and masks. One difference is intended: the ranges of sizes are shares of
the picture, but mmdetection has them in pixels of its training pictures.
"""

from collections import OrderedDict
from collections.abc import Sequence
from math import inf
from typing import final

import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, interpolate, max_pool2d, one_hot
from torchvision.ops import FeaturePyramidNetwork, masks_to_boxes
from torchvision.ops.feature_pyramid_network import LastLevelMaxPool

from .backbones import open_backbone
from .network import Network, NetworkOutput, Recipe, Target

# Each level has one entry. An instance belongs to the levels whose range contains the root of its
# box's area, relative to the root of the picture's area: two levels, as ranges overlap.
GRIDS = (40, 36, 24, 16, 12)
RANGES = ((0, 3 / 32), (3 / 64, 3 / 16), (3 / 32, 3 / 8), (3 / 16, 3 / 4), (3 / 8, inf))
LEAST_SIDE_PX = 1.0
# On each level, a mask with fewer map pixels than this is noise.
LEAST_AREA = (8, 8, 16, 32, 32)
MASK_STRIDE = 4
HEADS = {"darknet53": (512, 4, 256), "resnet50": (512, 4, 256), "resnet18": (256, 2, 128)}
PYRAMID_WIDTH = 256
# Cells are positives if their centre is in this share of the box around the centre of mass.
CENTRE_SHARE = 0.2
MASK_WEIGHT = 3.0
FOCAL_ALPHA, FOCAL_GAMMA = 0.25, 2.0
DICE_EPS = 1e-3
NMS_SIGMA = 2.0


@final
class Solov2(Network):
    """A network that finds masks and the boxes around them.

    With `resnet50`, this is the paper's SOLOv2, and with `resnet18` its SOLOv2-light. The small
    backbones have a head of half the width.
    """

    finds_masks = True
    recipe = Recipe(learning_rate=3e-4, batch=4, weight_decay=0.01)

    def __init__(
        self, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
    ) -> None:
        super().__init__()
        self.body = open_backbone(backbone or "resnet18", channels=channels)
        # Width and depth of the head's towers, and the channels of masks.
        width, depth, kernel = HEADS.get(self.body.name, (128, 2, 64))
        self.classes = classes
        self.pyramid = FeaturePyramidNetwork(
            list(self.body.channels), PYRAMID_WIDTH, extra_blocks=LastLevelMaxPool()
        )
        self.painter = _Painter(kernel)
        self.kernels = _tower(PYRAMID_WIDTH + 2, width, depth, kernel)
        self.judges = _tower(PYRAMID_WIDTH, width, depth, classes)
        # Initial score of about 0.01 (sigmoid of -4.6), as nearly all cells are empty.
        nn.init.constant_(self.judges[-1].bias, -4.6)

    def forward(
        self, image: Float[Tensor, "b c h w"]
    ) -> tuple[
        Float[Tensor, "b cells classes"],
        Float[Tensor, "b cells kernel"],
        Float[Tensor, "b kernel h4 w4"],
    ]:
        """Return the scores (logits) and kernels of all levels' cells, and the mask feature map."""
        maps = OrderedDict((str(i), m) for i, m in enumerate(self.body(image)))
        levels = list(self.pyramid(maps).values())
        painted = self.painter(levels[:4])
        half = interpolate(levels[0], scale_factor=0.5, mode="bilinear")
        last = interpolate(levels[4], size=levels[3].shape[-2:], mode="bilinear")
        scores, kernels = [], []
        for level, grid in zip((half, *levels[1:4], last), GRIDS, strict=True):
            where = interpolate(_with_place(level), size=(grid, grid), mode="bilinear")
            kernels.append(self.kernels(where).flatten(2))
            scores.append(self.judges(where[:, :-2]).flatten(2))
        score, kernel = (torch.cat(parts, dim=2).transpose(1, 2) for parts in (scores, kernels))
        return score.float(), kernel.float(), painted.float()

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Return the Dice loss of cells that own an instance, and the focal loss of all cells."""
        score, kernel, painted = self(image)
        labels = torch.full(score.shape[:2], self.classes, device=score.device)
        counts = torch.ones_like(labels, dtype=torch.bool)
        dice = painted.sum() * 0
        for index, target in enumerate(targets):
            owner, cell = _claims(target)
            ignored = target.ignored[owner]
            counts[index, cell[ignored]] = False
            owner, cell = owner[~ignored], cell[~ignored]
            counts[index, cell] = True
            for instance, place in zip(owner.tolist(), cell.tolist(), strict=True):
                labels[index, place] = target.label[instance]
            logit = torch.einsum("nk,khw->nhw", kernel[index, cell], painted[index])
            dice = dice + _dice(logit.sigmoid(), _quarter(target.masks())[owner]).sum()
        claimed = int((labels < self.classes).sum())
        truth = one_hot(labels, self.classes + 1)[..., :-1].float()
        focal = _focal(score[counts], truth[counts]) / (claimed + 1)
        return {"mask": MASK_WEIGHT * dice / max(claimed, 1), "class": focal}

    @torch.no_grad()
    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Return the masks whose score after Matrix NMS is high enough."""
        answers = zip(*self(image), strict=True)
        return [self._find(*answer, most=most, least_score=least_score) for answer in answers]

    def _find(
        self,
        score: Float[Tensor, "cells classes"],
        kernel: Float[Tensor, "cells kernel"],
        painted: Float[Tensor, "kernel h w"],
        *,
        most: int,
        least_score: float,
    ) -> NetworkOutput:
        # Scores only fall from here on, so scores below the limit are dropped at once.
        score = _peaks(score.sigmoid())
        best, place = score.flatten().topk(min(max(500, 2 * most), score.numel()))
        place, best = place[best >= max(least_score, 1e-6)], best[best >= max(least_score, 1e-6)]
        cell, label = place // self.classes, place % self.classes
        mask = torch.einsum("nk,khw->nhw", kernel[cell], painted).sigmoid()
        inside = mask > 0.5
        area = inside.sum(dim=(1, 2))
        fill = (mask * inside).sum(dim=(1, 2)) / area.clamp(min=1)
        cells = torch.tensor([grid * grid for grid in GRIDS])
        least_area = torch.tensor(LEAST_AREA).repeat_interleave(cells).to(score.device)
        index = (area > least_area[cell]).nonzero()[:, 0]
        index = index[(best * fill)[index].argsort(descending=True, stable=True)]
        best, label = (best * fill)[index], label[index]
        best = best * _decay(inside[index].flatten(1).float(), label)
        order = best.argsort(descending=True, stable=True)[:most]
        order = order[best[order] >= least_score]
        return _output(mask[index][order], label[order], best[order])


@final
class _Painter(nn.Module):
    """A module for the mask feature map: the sum of all levels at a quarter of the picture size."""

    def __init__(self, outside: int, width: int = 128) -> None:
        super().__init__()
        self.levels = nn.ModuleList()
        for level in range(4):
            place = 2 if level == 3 else 0  # The coarsest level gets the coordinates.
            steps = []
            for step in range(max(level, 1)):
                inside = PYRAMID_WIDTH + place if step == 0 else width
                steps.append(_convolution(inside, width, 3))
                if level:
                    steps.append(nn.Upsample(scale_factor=2, mode="bilinear"))
            self.levels.append(nn.Sequential(*steps))
        self.last = _convolution(width, outside, 1)

    def forward(self, maps: Sequence[Tensor]) -> Float[Tensor, "b kernel h w"]:
        maps = [*maps[:3], _with_place(maps[3])]
        return self.last(sum(level(m) for level, m in zip(self.levels, maps, strict=True)))


def _convolution(inside: int, outside: int, size: int) -> nn.Sequential:
    convolution = nn.Conv2d(inside, outside, size, padding=size // 2, bias=False)
    nn.init.normal_(convolution.weight, std=0.01)
    return nn.Sequential(convolution, nn.GroupNorm(32, outside), nn.ReLU())


def _tower(inside: int, width: int, depth: int, outside: int) -> nn.Sequential:
    widths = [inside, *[width] * (depth - 1)]
    last = nn.Conv2d(width, outside, 3, padding=1)
    nn.init.normal_(last.weight, std=0.01)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*(_convolution(w, width, 3) for w in widths), last)


def _with_place(maps: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c2 h w"]:
    """Append channels with x and y, from -1 at the first pixel to 1 at the last (CoordConv)."""
    y, x = (torch.linspace(-1, 1, side, device=maps.device) for side in maps.shape[-2:])
    place = torch.stack(torch.meshgrid(x, y, indexing="xy")).to(maps.dtype)
    return torch.cat([maps, place.expand(len(maps), -1, -1, -1)], dim=1)


def _quarter(mask: Bool[Tensor, "n h w"]) -> Float[Tensor, "n h4 w4"]:
    """Return masks at the map's stride: true if two of the middle four of 4 x 4 pixels are true."""
    middle = [slice(first, None, MASK_STRIDE) for first in (1, 2)]
    return (sum(mask[:, row, column].int() for row in middle for column in middle) >= 2).float()


def _claims(target: Target) -> tuple[Int64[Tensor, " m"], Int64[Tensor, " m"]]:
    """Return pairs of an instance and a cell that it owns, sorted by level, then by instance."""
    mask = target.masks()
    size = torch.tensor([mask.shape[2], mask.shape[1]], device=mask.device)
    sides = target.box[:, 2:] - target.box[:, :2]
    side = sides.prod(dim=1).sqrt()
    share = side / size.prod().float().sqrt()
    centre = _centre_of_mass(mask)
    reach = sides / 2 * CENTRE_SHARE
    real = mask.flatten(1).any(dim=1) & (side >= LEAST_SIDE_PX)
    owners: list[int] = []
    cells: list[int] = []
    first = 0
    for grid, (least, largest) in zip(GRIDS, RANGES, strict=True):
        middle = (centre / size * grid).long()
        low = ((centre - reach) / size * grid).long().clamp(min=0).maximum(middle - 1)
        high = ((centre + reach) / size * grid).long().clamp(max=grid - 1).minimum(middle + 1)
        here = (share >= least) & (share <= largest) & real
        for instance in here.nonzero()[:, 0].tolist():
            (left, top), (right, bottom) = low[instance].tolist(), high[instance].tolist()
            for row in range(top, bottom + 1):
                cells += range(first + row * grid + left, first + row * grid + right + 1)
            owners += [instance] * (len(cells) - len(owners))
        first += grid * grid
    owner, cell = (torch.tensor(v, dtype=torch.int64, device=mask.device) for v in (owners, cells))
    return owner, cell


def _centre_of_mass(mask: Bool[Tensor, "n h w"]) -> Float[Tensor, "n 2"]:
    """Return the mean column and row of each mask's pixels; 0, 0 for an empty mask."""
    column, row = (torch.arange(n, device=mask.device) for n in (mask.shape[2], mask.shape[1]))
    total = torch.stack([(mask.sum(1) * column).sum(1), (mask.sum(2) * row).sum(1)], dim=1)
    return total / mask.sum(dim=(1, 2)).clamp(min=1)[:, None]


def _dice(mask: Float[Tensor, "n h w"], truth: Float[Tensor, "n h w"]) -> Float[Tensor, " n"]:
    """Return the Dice loss: 1 - 2 overlap / sum of squares (Milletari et al., V-Net, 2016)."""
    both = (mask * truth).sum(dim=(1, 2))
    return 1 - 2 * both / (
        mask.square().sum(dim=(1, 2)) + truth.square().sum(dim=(1, 2)) + 2 * DICE_EPS
    )


def _focal(logit: Float[Tensor, "n k"], truth: Float[Tensor, "n k"]) -> Float[Tensor, ""]:
    """Return the focal loss: cross-entropy, smaller for correct answers (Lin et al., 2017)."""
    score = logit.sigmoid()
    wrong = (truth - score).abs()
    weight = FOCAL_ALPHA * truth + (1 - FOCAL_ALPHA) * (1 - truth)
    loss = binary_cross_entropy_with_logits(logit, truth, reduction="none")
    return (weight * wrong**FOCAL_GAMMA * loss).sum()


def _peaks(score: Float[Tensor, "cells classes"]) -> Float[Tensor, "cells classes"]:
    """Return the scores, but 0 if the cell above, left or above-left has a higher score."""
    out = []
    for level in score.split([grid * grid for grid in GRIDS]):
        grid = round(len(level) ** 0.5)
        square = level.T.reshape(-1, grid, grid)
        highest = max_pool2d(square[None], 2, stride=1, padding=1)[0, :, :-1, :-1]
        out.append((square * (highest == square)).flatten(1).T)
    return torch.cat(out)


def _decay(mask: Float[Tensor, "n pixels"], label: Int64[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Return the factor by which Matrix NMS lowers each score; the masks are sorted, best first.

    This is the paper's equation 5 (Gaussian): the minimum over better masks i of its class of
    exp(-s iou_ij^2) / exp(-s worst_i^2), where worst_i is i's largest overlap with a better mask.
    """
    if not len(mask):
        return mask.new_zeros(0)
    both, area = mask @ mask.T, mask.sum(dim=1)
    overlap = both / (area + area[:, None] - both)
    overlap = (overlap * (label == label[:, None])).triu(diagonal=1)
    worst = overlap.amax(dim=0)
    return torch.exp(NMS_SIGMA * (worst[:, None] ** 2 - overlap**2)).amin(dim=0)


def _output(
    mask: Float[Tensor, "n h w"], label: Int64[Tensor, " n"], score: Float32[Tensor, " n"]
) -> NetworkOutput:
    """Return masks at the scale of the input, and the boxes around these masks."""
    count, height, width = mask.shape
    if count:
        mask = interpolate(mask[None], scale_factor=MASK_STRIDE, mode="bilinear")[0]
    mask = mask.reshape(count, height * MASK_STRIDE, width * MASK_STRIDE)
    painted = (mask * 255).round().to(torch.uint8)
    keep = (painted > 127).flatten(1).any(dim=1)
    painted = painted[keep]
    box = masks_to_boxes(painted > 127) if len(painted) else mask.new_zeros(0, 4)
    box = box + box.new_tensor([0, 0, 1, 1])  # Both end pixels are inside.
    return NetworkOutput(box=box, label=label[keep], score=score[keep], mask=painted)
