"""The common interface of all networks: losses for training, and detection."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor, nn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """The labels of one picture, in pixels of the network's input.

    Attributes:
        box: x0, y0, x1, y1 of the outer edges; the origin is the outer corner of the picture.
        label: classes, from 0.
        mask: visible pixels of each instance; None if the network does not need masks.
        ignored: whether too little of an instance is visible: the network need not find it, and a
            detection of it is no mistake.
    """

    box: Float[Tensor, "n 4"]
    label: Int64[Tensor, " n"]
    mask: Bool[Tensor, "n h w"] | None
    ignored: Bool[Tensor, " n"]

    def masks(self) -> Bool[Tensor, "n h w"]:
        """Return the masks, for a network that needs them.

        Raises:
            ValueError: the target has no masks.
        """
        if self.mask is None:
            raise ValueError("this network learns from masks, and the target has none")
        return self.mask

    def to(self, device: torch.device) -> "Target":
        """Return the same target on a device."""
        return Target(
            box=self.box.to(device),
            label=self.label.to(device),
            mask=None if self.mask is None else self.mask.to(device),
            ignored=self.ignored.to(device),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkOutput:
    """Detections in one picture, best first, in pixels of the network's input.

    `mask` is a probability from 0 to 255, with the edge at 127.5; it is None if the network finds
    only boxes.
    """

    box: Float[Tensor, "n 4"]
    label: Int64[Tensor, " n"]
    score: Float[Tensor, " n"]
    mask: UInt8[Tensor, "n h w"] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """The default settings of a network's training, whose optimizer is AdamW.

    Attributes:
        learning_rate: highest learning rate, for a batch of `batch` pictures.
        batch: number of pictures in a step.
        weight_decay: weight decay of matrices; biases and norms have none.
    """

    learning_rate: float
    batch: int
    weight_decay: float


class Network(nn.Module):
    """Base of all networks: training on labels, and detection of parts.

    The input, made by `encoding.Encoding`, is `(b, channels, h, w)` float; h and w are multiples of
    32. All random choices use torch's global generator, which the training loop seeds.

    The constructor draws random weights from torch's global generator and has these arguments:

        channels: number of channels of the input.
        classes: number of classes of parts; the background is not a class.
        backbone: name of a backbone of the model, usually one of `backbones`; None for the
            model's default.
        size_px: height and width of the input, multiples of 32.
    """

    finds_masks: bool
    recipe: Recipe

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Return the terms of the loss by name; training minimizes their sum. Needs train mode."""
        raise NotImplementedError

    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Return the detections in each picture: at most `most`, with at least `least_score`.

        The caller must call `network.eval()` before: in train mode, batch norms would adapt to the
        pictures, and some networks would return losses.
        """
        raise NotImplementedError
