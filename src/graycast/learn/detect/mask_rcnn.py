"""Mask R-CNN (He et al., ICCV 2017) from torchvision's pieces, on a feature pyramid.

Graycast changes two things: smaller sizes (the published ones are for photographs of 80 classes),
and ignored instances, which torchvision does not have.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.faster_rcnn import FastRCNNPredictor, TwoMLPHead
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.mask_rcnn import MaskRCNNHeads, MaskRCNNPredictor
from torchvision.models.detection.roi_heads import RoIHeads, paste_masks_in_image
from torchvision.models.detection.rpn import RegionProposalNetwork, RPNHead
from torchvision.ops import FeaturePyramidNetwork, MultiScaleRoIAlign
from torchvision.ops.feature_pyramid_network import LastLevelMaxPool

from .backbones import open_backbone
from .network import Network, NetworkOutput, Recipe, Target

_PYRAMID = 128
_HEAD = 512
_LEVELS = ("0", "1", "2", "3")
_ANCHOR_PX = (16, 32, 64, 128, 256)
_PROPOSALS = {"training": 1000, "testing": 1000}
_MOST = 300
_HIDDEN_SHARE = 0.5  # An anchor with a larger share inside an ignored box is not a negative.


@final
class MaskRcnn(Network):
    """Mask R-CNN: boxes in two stages, then a mask of 28 x 28 in each box."""

    finds_masks = True
    recipe = Recipe(learning_rate=4e-4, batch=4, weight_decay=0.05)

    def __init__(
        self, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
    ) -> None:
        super().__init__()
        self.body = open_backbone(backbone or "resnet18", channels=channels)
        self.pyramid = FeaturePyramidNetwork(
            list(self.body.channels), _PYRAMID, extra_blocks=LastLevelMaxPool()
        )
        anchors = AnchorGenerator(tuple((s,) for s in _ANCHOR_PX), ((0.5, 1.0, 2.0),) * 5)
        self.rpn = _Proposals(
            anchors,
            RPNHead(_PYRAMID, anchors.num_anchors_per_location()[0]),
            fg_iou_thresh=0.7,
            bg_iou_thresh=0.3,
            batch_size_per_image=256,
            positive_fraction=0.5,
            pre_nms_top_n=_PROPOSALS,
            post_nms_top_n={"training": 500, "testing": 500},
            nms_thresh=0.7,
        )
        self.heads = RoIHeads(
            MultiScaleRoIAlign(_LEVELS, 7, 2),
            TwoMLPHead(_PYRAMID * 7 * 7, _HEAD),
            FastRCNNPredictor(_HEAD, classes + 1),
            fg_iou_thresh=0.5,
            bg_iou_thresh=0.5,
            batch_size_per_image=128,
            positive_fraction=0.25,
            bbox_reg_weights=None,
            score_thresh=0.0,
            nms_thresh=0.5,
            detections_per_img=_MOST,
            mask_roi_pool=MultiScaleRoIAlign(_LEVELS, 14, 2),
            mask_head=MaskRCNNHeads(_PYRAMID, (_PYRAMID,) * 4, 1),
            mask_predictor=MaskRCNNPredictor(_PYRAMID, _PYRAMID, classes + 1),
        )

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        # Train mode only selects losses instead of results, as there are no norms and no dropout.
        self.rpn.train(), self.heads.train()
        images, maps = self._maps(image)
        annotations = [_torchvision_target(target) for target in targets]
        proposals, rpn = self.rpn(images, maps, annotations)
        _, heads = self.heads(maps, proposals, images.image_sizes, annotations)
        return {**rpn, **heads}

    @torch.no_grad()
    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        self.rpn.eval(), self.heads.eval()
        images, maps = self._maps(image)
        self.heads.detections_per_img = most
        # torchvision keeps scores above its threshold, but not equal ones.
        self.heads.score_thresh = float(np.nextafter(np.float32(least_score), np.float32(-1)))
        proposals, _ = self.rpn(images, maps)
        results, _ = self.heads(maps, proposals, images.image_sizes)
        size = image.shape[-2:]
        return [
            NetworkOutput(
                box=result["boxes"],
                label=result["labels"] - 1,
                score=result["scores"],
                mask=_pasted(result["masks"], result["boxes"], size),
            )
            for result in results
        ]

    def _maps(self, image: Tensor) -> tuple[ImageList, dict[str, Tensor]]:
        maps = self.pyramid(OrderedDict(zip(_LEVELS, self.body(image), strict=True)))
        sizes = [tuple(image.shape[-2:])] * len(image)
        return ImageList(image, sizes), maps


@final
class _Proposals(RegionProposalNetwork):
    """A proposal network whose training ignores proposals on ignored instances.

    The second stage needs no change, because it skips proposals that match the label -1.
    """

    def assign_targets_to_anchors(
        self, anchors: list[Tensor], targets: list[dict[str, Tensor]]
    ) -> tuple[list[Tensor], list[Tensor]]:
        counted = [{"boxes": target["boxes"][target["labels"] > 0]} for target in targets]
        labels, matched = super().assign_targets_to_anchors(anchors, counted)
        for label, anchor, target in zip(labels, anchors, targets, strict=True):
            hidden = target["boxes"][target["labels"] < 0]
            if len(hidden):
                label[(label == 0) & (_covered(anchor, hidden) > _HIDDEN_SHARE)] = -1
        return labels, matched


def _covered(box: Float[Tensor, "n 4"], by: Float[Tensor, "m 4"]) -> Float[Tensor, " n"]:
    """Return the largest share of each box that a single box of `by` covers."""
    low = torch.maximum(box[:, None, :2], by[None, :, :2])
    high = torch.minimum(box[:, None, 2:], by[None, :, 2:])
    shared = (high - low).clamp(min=0).prod(dim=2)
    return (shared / (box[:, 2:] - box[:, :2]).prod(dim=1, keepdim=True)).amax(dim=1)


def _torchvision_target(target: Target) -> dict[str, Tensor]:
    """Return a target in torchvision's convention: label 0 is the background, -1 is ignored."""
    return {
        "boxes": target.box,
        "labels": torch.where(target.ignored, -1, target.label + 1),
        "masks": target.masks().to(torch.uint8),
    }


def _pasted(mask: Tensor, box: Tensor, size: Sequence[int]) -> Tensor:
    full = paste_masks_in_image(mask, box, tuple(size))[:, 0]
    return (255 * full).round().to(torch.uint8)
