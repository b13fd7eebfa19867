"""RF-DETR: boxes by a transformer without anchors, from rfdetr (Apache-2.0).

Network, matching, loss and choice of boxes are the library's. Ours here: any number of channels,
nothing downloaded, and what ignored instances mean. Its largest sizes, which have another licence,
and its masks, whose patches need other picture sizes than multiples of 32, are not offered.

Source: Robinson, Robicheaux, Popov, Ramanan & Peri, "RF-DETR: Neural Architecture Search for
Real-Time Detection Transformers", 2025.
"""

from collections.abc import Mapping, Sequence
from typing import Any, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torchvision.ops import box_convert, box_iou

from ...base.errors import GraycastError
from .network import Network, NetworkOutput, Recipe, Target

SIZES = ("nano", "small", "medium", "large")
# A query that overlaps an ignored instance by more than this, and more than any other, may mean it.
OVERLAP = 0.5
SILENT = -30.0  # The loss of this logit against "nothing here" is zero in single precision.
# The names of the library's losses begin so; each is there once a layer.
TERMS = {"class": "loss_ce", "box": "loss_bbox", "overlap": "loss_giou"}


@final
class RfDetr(Network):
    """Finds boxes, at most 300 and at most one for each patch of a picture.

    Its backbones are its own, named by `SIZES`.
    """

    finds_masks = False
    recipe = Recipe(learning_rate=1e-4, batch=4, weight_decay=1e-4)

    def __init__(
        self, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
    ) -> None:
        super().__init__()
        try:
            from rfdetr import config
            from rfdetr.models.lwdetr import build_criterion_from_config, build_model_from_config
        except ImportError as error:
            raise GraycastError(
                f"model rf-detr needs rfdetr ({error}): run pip install 'graycast[rf-detr]'"
            ) from error
        name = backbone or "nano"
        if name not in SIZES:
            choices = ", ".join(SIZES)
            raise GraycastError(f"model rf-detr has no backbone {name!r}: choose {choices}")
        size = getattr(config, f"RFDETR{name.capitalize()}Config")
        # The library adds a class to the number that it gets. A name of weights, which it does not
        # read here, keeps it from downloading its own.
        described = size(
            num_classes=classes - 1,
            num_queries=_queries(size, size_px),
            pretrain_weights="none",
            device="cpu",
        )
        training = config.TrainConfig(dataset_dir=".", output_dir=".")
        self.network = build_model_from_config(described, training)
        self.criterion, self._choose = build_criterion_from_config(described, training)
        self._see(channels)

    def _see(self, channels: int) -> None:
        """Replace the first layer by one for another number of channels, if they differ."""
        patches = self.network.backbone[0].encoder.encoder.embeddings.patch_embeddings
        first = patches.projection
        if channels != first.in_channels:
            patches.num_channels = channels
            patches.projection = nn.Conv2d(
                channels, first.out_channels, first.kernel_size, first.stride
            )
            nn.init.trunc_normal_(patches.projection.weight, std=0.02)
            nn.init.zeros_(patches.projection.bias)

    def forward(self, image: Float[Tensor, "b c h w"]) -> dict[str, Any]:
        """Return the library's answer: logits and boxes of every query, of every layer."""
        return self.network(image)

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Terms of the library's loss with its weights, added up over its layers."""
        answer = self(image)
        height, width = image.shape[-2:]
        size = image.new_tensor([width, height, width, height], dtype=torch.float32)
        labels = [
            {
                "labels": t.label[~t.ignored],
                "boxes": box_convert(t.box[~t.ignored] / size, "xyxy", "cxcywh"),
            }
            for t in targets
        ]
        hidden = [t.box[t.ignored] / size for t in targets]
        if any(len(boxes) for boxes in hidden):
            answer = self._without_ignored(answer, labels, hidden)
        losses = self.criterion(answer, labels)
        weights = self.criterion.weight_dict
        return {
            term: sum(losses[name] * weights[name] for name in weights if name.startswith(begin))
            for term, begin in TERMS.items()
        }

    @torch.no_grad()
    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Return the library's choice: the best pairs of query and class."""
        size = torch.tensor([list(image.shape[-2:])] * len(image), device=image.device)
        outputs = []
        for best in self._choose(self(image), size):
            index = (best["scores"] >= least_score).nonzero()[:most, 0]
            box, label, score = (best[name][index] for name in ("boxes", "labels", "scores"))
            outputs.append(
                NetworkOutput(box=box.float(), label=label, score=score.float(), mask=None)
            )
        return outputs

    def _without_ignored(
        self,
        answer: Mapping[str, Any],
        labels: list[dict[str, Tensor]],
        hidden: Sequence[Tensor],
    ) -> dict[str, Any]:
        """Return the same answer, where queries that may mean an ignored instance claim nothing."""
        layers = [{**y, **self._quiet_layer(y, labels, hidden)} for y in answer["aux_outputs"]]
        first = answer["enc_outputs"]
        return {
            **answer,
            **self._quiet_layer(answer, labels, hidden),
            "aux_outputs": layers,
            "enc_outputs": {**first, **self._quiet_layer(first, labels, hidden)},
        }

    def _quiet_layer(
        self,
        layer: Mapping[str, Any],
        labels: list[dict[str, Tensor]],
        hidden: Sequence[Tensor],
    ) -> dict[str, Tensor]:
        """Return a layer's logits, suppressed except for queries that are matched to an instance.

        The matching of the changed answer is that of the answer: only pairs outside it got worse.
        """
        groups = self.criterion.group_detr if self.training else 1
        matched = self.criterion.matcher(layer, labels, group_detr=groups)
        silent = torch.zeros_like(layer["pred_logits"][..., 0], dtype=torch.bool)
        for index, (query, _) in enumerate(matched):
            box = box_convert(layer["pred_boxes"][index].detach().float(), "cxcywh", "xyxy")
            real = box_convert(labels[index]["boxes"], "cxcywh", "xyxy")
            silent[index] = _means_ignored(box, hidden[index], real)
            silent[index, query.to(silent.device)] = False
        return {"pred_logits": layer["pred_logits"].masked_fill(silent[..., None], SILENT)}


def _queries(size: Any, size_px: tuple[int, int]) -> int:
    """Return the number of queries of a size, but at most the number of patches in a picture.

    Each query starts at a patch of its own. In training, the library hands the patches on to its
    groups of queries as if there were enough for all: if not, whole groups get none, and others
    those of another group, and the scores do not converge.
    """
    known = size.model_fields
    patch_px = known["patch_size"].default
    patches = (size_px[0] // patch_px) * (size_px[1] // patch_px)
    return min(known["num_queries"].default, patches)


def _means_ignored(
    box: Float[Tensor, "queries 4"], hidden: Float[Tensor, "n 4"], real: Float[Tensor, "m 4"]
) -> Bool[Tensor, " queries"]:
    """Queries that overlap an ignored instance by more than `OVERLAP`, and others by less."""
    nothing = box.new_zeros(len(box), 1)
    to_hidden, to_real = (
        torch.cat([nothing, box_iou(box, boxes)], dim=1).amax(dim=1) for boxes in (hidden, real)
    )
    return (to_hidden > OVERLAP) & (to_hidden > to_real)
