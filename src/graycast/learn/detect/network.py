"""The interface of all networks: training on labels and finding parts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

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

    def drawn(self) -> Bool[Tensor, "n h w"]:
        """The masks, for a network that asks for them.

        Raises:
            ValueError: there are none.
        """
        if self.mask is None:
            raise ValueError("this network learns from masks, and the target has none")
        return self.mask

    def to(self, device: torch.device) -> "Target":
        """The same on a device."""
        return Target(
            box=self.box.to(device),
            label=self.label.to(device),
            mask=None if self.mask is None else self.mask.to(device),
            ignored=self.ignored.to(device),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkOutput:
    """What a network finds in one picture, best first, in pixels of its input.

    `mask` is a probability, 0 to 255; its edge is where it crosses 127.5. None from a network that
    has boxes alone.
    """

    box: Float[Tensor, "n 4"]
    label: Int64[Tensor, " n"]
    score: Float[Tensor, " n"]
    mask: UInt8[Tensor, "n h w"] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """The default settings of a network's training.

    Attributes:
        optimizer: `sgd` (momentum 0.9) or `adamw`.
        learning_rate: at its highest, for a batch of `batch` pictures.
        batch: pictures in a step.
        weight_decay: of matrices; biases and norms have none.
    """

    optimizer: str
    learning_rate: float
    batch: int
    weight_decay: float


@runtime_checkable
class Network(Protocol):
    """A `torch.nn.Module` with these further methods.

    Input is `(b, channels, h, w)` float, h and w multiples of 32, made by `encoding.Encoding`. All
    random choices use torch's global generator, which the training loop owns.

    A network is made with `channels`, `classes`, `backbone` and `size_px`; see `open_network`. The
    backbone of most is one of `backbones`; of `rf-detr`, which is sold as one piece, it is the name
    of a size, such as `nano`.
    """

    finds_masks: bool
    recipe: Recipe

    def losses(
        self, image: Float[Tensor, "b c h w"], targets: Sequence[Target]
    ) -> dict[str, Tensor]:
        """Terms of the loss by name; their sum is what training makes small. In train mode."""
        ...

    def find(
        self, image: Float[Tensor, "b c h w"], *, most: int, least_score: float
    ) -> list[NetworkOutput]:
        """Detections of each picture: at most so many, of at least that score.

        The network is in eval mode: the caller has said `network.eval()`. In train mode its norms
        would follow the pictures that it looks at, and some networks answer with losses instead.
        """
        ...

    # Of `torch.nn.Module`: what is asked of a network.

    def train(self) -> "Network": ...

    def eval(self) -> "Network": ...

    def to(self, device: torch.device, *, memory_format: torch.memory_format) -> "Network": ...

    def parameters(self) -> Iterator[nn.Parameter]: ...

    def state_dict(self) -> dict[str, Tensor]: ...

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> object: ...


@runtime_checkable
class NetworkClass(Protocol):
    """What a model's networks are made by."""

    finds_masks: bool

    def __call__(
        self, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
    ) -> Network: ...
