"""Train your own detector: RF-DETR from the library rfdetr (Apache-2.0).

Any subclass of `Network` can be trained, validated and used. This subclass takes the network, the
loss and the selection of boxes from the library. It downloads no weights.

Leaves out: ignored instances. In training, a box on a nearly hidden part counts as a mistake.

Needs: pip install 'graycast[detect]' rfdetr
Run: .venv/bin/python examples/09_own_detector.py out/demo out/rf_detr
"""

import sys

import torch
from rfdetr import config
from rfdetr.models.lwdetr import build_criterion_from_config, build_model_from_config
from torch import Tensor, nn
from torchvision.ops import box_convert

import graycast
from graycast.learn.detect.network import Network, NetworkOutput, Recipe


class RfDetr(Network):
    """Boxes from a transformer without anchors; the backbone is nano, small, medium or large."""

    finds_masks = False
    recipe = Recipe(learning_rate=1e-4, batch=4, weight_decay=1e-4)

    def __init__(self, *, channels: int, classes: int, backbone: str | None, size_px) -> None:
        super().__init__()
        size = getattr(config, f"RFDETR{(backbone or 'nano').capitalize()}Config")
        known = {name: field.default for name, field in size.model_fields.items()}
        # Each query starts at a patch. With more queries than patches, the scores do not converge.
        patches = (size_px[0] // known["patch_size"]) * (size_px[1] // known["patch_size"])
        described = size(
            num_classes=classes - 1,  # The library adds one class.
            num_queries=min(known["num_queries"], patches), pretrain_weights="none", device="cpu",
        )  # fmt: skip
        training = config.TrainConfig(dataset_dir=".", output_dir=".")
        self.network = build_model_from_config(described, training)
        self.criterion, self.choose = build_criterion_from_config(described, training)
        first = self.network.backbone[0].encoder.encoder.embeddings.patch_embeddings
        if channels != first.projection.in_channels:
            old, first.num_channels = first.projection, channels
            first.projection = nn.Conv2d(channels, old.out_channels, old.kernel_size, old.stride)

    def losses(self, image: Tensor, targets) -> dict[str, Tensor]:
        height, width = image.shape[-2:]
        size = image.new_tensor([width, height, width, height], dtype=torch.float32)
        labels = []
        for target in targets:
            box = box_convert(target.box[~target.ignored] / size, "xyxy", "cxcywh")
            labels.append({"labels": target.label[~target.ignored], "boxes": box})
        losses = self.criterion(self.network(image), labels)
        return {name: losses[name] * w for name, w in self.criterion.weight_dict.items()}

    @torch.no_grad()
    def find(self, image: Tensor, *, most: int, least_score: float) -> list[NetworkOutput]:
        size = torch.tensor([list(image.shape[-2:])] * len(image), device=image.device)
        outputs = []
        for best in self.choose(self.network(image), size):
            keep = (best["scores"] >= least_score).nonzero()[:most, 0]
            box, label, score = (best[name][keep] for name in ("boxes", "labels", "scores"))
            outputs.append(NetworkOutput(box=box, label=label, score=score, mask=None))
        return outputs


def main(dataset: str, out: str, epochs: int) -> None:
    spec = graycast.TrainSpec(epochs=epochs, longest_px=320)
    graycast.train([dataset], out, spec, network=RfDetr)
    detector = graycast.load_detector(out, network=RfDetr)
    pictures = graycast.pictures_of(dataset, detector.about, split="test")
    result = graycast.detect(detector, pictures, f"{out}_boxes")
    print(f"{sum(len(each.score) for each in result.found)} boxes: see {out}_boxes")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], epochs=int(sys.argv[3]) if len(sys.argv) > 3 else 16)
