"""The interface of all networks: training on labels and finding parts."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor, nn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """Labels of one picture, in pixels of the network's input.

    Attributes:
        box: x0, y0, x1, y1: outer edges, from the outer corner of the top-left pixel on.
        label: classes, from 0.
        mask: what is visible of each; None where the network does not ask for masks.
        ignored: an instance too hidden to count: the network need not find it, and a detection
            there is no mistake.
    """

    box: Float[Tensor, "n 4"]
    label: Int64[Tensor, " n"]
    mask: Bool[Tensor, "n h w"] | None
    ignored: Bool[Tensor, " n"]

    def masks(self) -> Bool[Tensor, "n h w"]:
        """Return masks, for a network that asks for them.

        Raises:
            ValueError: there are none.
        """
        if self.mask is None:
            raise ValueError("this network learns from masks, and the target has none")
        return self.mask

    def to(self, device: torch.device) -> "Target":
        """Return the same on a device."""
        return Target(
            box=self.box.to(device),
            label=self.label.to(device),
            mask=None if self.mask is None else self.mask.to(device),
            ignored=self.ignored.to(device),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkOutput:
    """Detections in one picture, best first, in pixels of the network's input.

    `mask` is a probability, 0 to 255; its edge is where it crosses 127.5. None from a network that
    has boxes alone.
    """

    box: Float[Tensor, "n 4"]
    label: Int64[Tensor, " n"]
    score: Float[Tensor, " n"]
    mask: UInt8[Tensor, "n h w"] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """The default settings of a network's training, whose optimizer is AdamW.

    Attributes:
        learning_rate: at its highest, for a batch of `batch` pictures.
        batch: pictures in a step.
        weight_decay: of matrices; biases and norms have none.
    """

    learning_rate: float
    batch: int
    weight_decay: float


class Network(nn.Module):
    """Base of all networks: training on labels, and detection of parts.

    Input is `(b, channels, h, w)` float, h and w multiples of 32, made by `encoding.Encoding`. All
    random choices use torch's global generator, which the training loop owns.

    It is made with random weights, drawn from torch's global generator, and with these arguments:

        channels: of the input.
        classes: how many there are of parts; what is none of them is no class.
        backbone: the name of one that the model knows, most often one of `backbones`; None for
            its own choice.
        size_px: height and width of the input, multiples of 32.
    """

    finds_masks: bool
    recipe: Recipe

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Terms of the loss by name; their sum is what training makes small. In train mode."""
        raise NotImplementedError

    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Return detections of each picture: at most `most`, with at least `least_score`.

        The network is in eval mode: the caller has said `network.eval()`. In train mode its norms
        would follow the pictures that it looks at, and some networks answer with losses instead.
        """
        raise NotImplementedError
