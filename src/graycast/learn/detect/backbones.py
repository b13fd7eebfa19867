"""Backbones, which compute feature maps at 1/4 to 1/32 of an image's size, and their weights."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models import mobilenet_v2, mobilenet_v3_small, resnet18, resnet50

from ...base.errors import GraycastError
from .network import Network

BACKBONES = ("mobilenet-v3-small", "mobilenet-v2", "resnet18", "resnet50", "darknet53")
# The statistics of a norm move by this share in each step. Torchvision's 0.01 in MobileNetV3 is for
# a million steps; after some hundred steps, the first weights would still dominate.
NORM_MOMENTUM = 0.1


@final
class Backbone(nn.Module):
    """A classifier without its head: feature maps at 1/4, 1/8, 1/16 and 1/32 of the image's size.

    Its state dict has the names of the published classifier, so that published weights fit.

    Attributes:
        name: one of `BACKBONES`.
        channels: number of channels of each map.
    """

    def __init__(
        self,
        name: str,
        parts: Mapping[str, nn.Module],
        *,
        steps: Sequence[str],
        taps: Sequence[str],
        channels: tuple[int, ...],
        end: tuple[str, ...],
    ) -> None:
        """Set the order of `steps`, those with maps (`taps`), and weights to skip (`end`)."""
        super().__init__()
        self.name, self.channels = name, channels
        self._steps, self._taps, self._end = tuple(steps), frozenset(taps), end
        for part, module in parts.items():
            self.add_module(part, module)
        follow_fast(self)

    def forward(self, image: Float[Tensor, "b c h w"]) -> tuple[Tensor, ...]:
        maps = []
        for step in self._steps:
            image = self.get_submodule(step)(image)
            if step in self._taps:
                maps.append(image)
        return tuple(maps)


def open_backbone(name: str, *, channels: int) -> Backbone:
    """Return a backbone with random weights for images with the given number of channels.

    Raises:
        GraycastError: there is no such backbone.
    """
    end: tuple[str, ...]
    match name:
        case "mobilenet-v3-small":
            features = mobilenet_v3_small(num_classes=1).features
            taps, widths, end = (1, 3, 8, 12), (16, 24, 48, 576), ("classifier.",)
            return _mobilenet(name, features, channels, taps=taps, widths=widths, end=end)
        case "mobilenet-v2":
            features = mobilenet_v2(num_classes=1).features[:18]
            taps, widths, end = (3, 6, 13, 17), (24, 32, 96, 320), ("classifier.", "features.18.")
            return _mobilenet(name, features, channels, taps=taps, widths=widths, end=end)
        case "resnet18":
            return _resnet(name, resnet18(num_classes=1), 64, channels)
        case "resnet50":
            return _resnet(name, resnet50(num_classes=1), 256, channels)
        case "darknet53":
            return _darknet(name, channels)
        case _:
            raise GraycastError(f"no backbone {name!r}: choose one of {', '.join(BACKBONES)}")


def follow_fast(network: nn.Module) -> None:
    """Set the momentum of a network's batch norms, so that they adapt within tens of steps."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.momentum = NORM_MOMENTUM


def load_backbone(body: Backbone, state: Mapping[str, Tensor]) -> None:
    """Load the weights of a published classifier (RGB) into a backbone.

    If the backbone does not have three channels, each channel gets the mean over red, green and
    blue of the published first convolution, times 3 / channels. The response to equal values in all
    channels is then that of the classifier to grey.

    Args:
        body: the backbone, which is changed in place.
        state: weights by name, as published by torchvision; for `darknet53`, as by
            mmdetection.

    Raises:
        GraycastError: the weights belong to another network; the backbone stays unchanged.
    """
    own = body.state_dict()
    weights = {key: value for key, value in state.items() if not key.startswith(body._end)}
    weights = {k: v for k, v in own.items() if k.endswith("num_batches_tracked")} | weights
    first = next(iter(own))
    if first in weights and weights[first].shape[1] == 3 != own[first].shape[1]:
        # The first convolution is adapted to the number of channels.
        mean = weights[first].mean(dim=1, keepdim=True)
        channels = own[first].shape[1]
        weights[first] = mean.repeat(1, channels, 1, 1) * (3 / channels)
    for key in sorted(own.keys() ^ weights.keys()):
        has, lacks = ("backbone", "file") if key in own else ("file", "backbone")
        raise GraycastError(
            f"these weights do not belong to {body.name}: the {has} has {key!r} and the {lacks} "
            "has not"
        )
    for key, value in weights.items():
        if value.shape != own[key].shape:
            raise GraycastError(
                f"these weights are not of {body.name}: {key!r} has the shape "
                f"{tuple(value.shape)}, the backbone's has {tuple(own[key].shape)}"
            )
    body.load_state_dict(weights)


def load_weights(network: Network, file: Path) -> None:
    """Load weights from a file, which has another run's detector or a published backbone.

    Detector weights with other shapes (because of other classes) are not loaded.

    Raises:
        GraycastError: the file is missing or damaged, or has weights of another network.
    """
    state = _state(file)
    own = network.state_dict()
    if own.keys() == state.keys():
        fitting = {key: value for key, value in state.items() if value.shape == own[key].shape}
        if len(fitting) < 0.5 * len(own):
            raise GraycastError(
                f"{file}: holds weights of other shapes: give weights of the same backbone"
            )
        network.load_state_dict(own | fitting)
        return
    if not hasattr(network, "body"):
        raise GraycastError(
            f"{file}: holds weights of another network; give detector.pt of another training of "
            "this model, or omit --weights"
        )
    try:
        load_backbone(network.body, state)
    except GraycastError as error:
        raise GraycastError(f"{file}: {error}") from error


def _state(file: Path) -> Mapping[str, Any]:
    if not file.is_file():
        raise GraycastError(f"{file}: does not exist: give a file of weights")
    try:
        tensors = torch.load(file, map_location="cpu", weights_only=True)
        for key in ("state", "model", "state_dict"):
            tensors = tensors.get(key, tensors)
    except Exception as error:  # A damaged pickle can raise anything.
        raise GraycastError(
            f"{file}: is damaged or is not a file of weights: download it again"
        ) from error
    if not tensors or not all(isinstance(value, torch.Tensor) for value in tensors.values()):
        raise GraycastError(
            f"{file}: holds no weights by name: give a published backbone, or detector.pt of "
            "another training"
        )
    return tensors


def _mobilenet(
    name: str,
    features: nn.Sequential,
    channels: int,
    *,
    taps: tuple[int, ...],
    widths: tuple[int, ...],
    end: tuple[str, ...],
) -> Backbone:
    features[0][0] = _first(features[0][0], channels)
    return Backbone(
        name,
        {"features": features},
        steps=[f"features.{i}" for i in range(len(features))],
        taps=[f"features.{i}" for i in taps],
        channels=widths,
        end=end,
    )


def _resnet(name: str, network: nn.Module, width: int, channels: int) -> Backbone:
    network.conv1 = _first(network.conv1, channels)
    layers = [f"layer{i}" for i in (1, 2, 3, 4)]
    steps = ["conv1", "bn1", "relu", "maxpool", *layers]
    return Backbone(
        name,
        {step: network.get_submodule(step) for step in steps},
        steps=steps,
        taps=layers,
        channels=tuple(width * scale for scale in (1, 2, 4, 8)),
        end=("fc.",),
    )


def _first(convolution: nn.Conv2d, channels: int) -> nn.Conv2d:
    """Return the first convolution for other channels, with random weights if they differ."""
    if channels == convolution.in_channels:
        return convolution
    other = nn.Conv2d(
        channels,
        convolution.out_channels,
        convolution.kernel_size,
        convolution.stride,
        convolution.padding,
        bias=False,
    )
    nn.init.kaiming_normal_(other.weight, mode="fan_out", nonlinearity="relu")
    return other


def _darknet(name: str, channels: int) -> Backbone:
    """Return Darknet-53, the backbone of YOLOv3 (Redmon & Farhadi, 2018, Table 1)."""
    parts: dict[str, nn.Module] = {"conv1": Convolution(channels, 32, 3)}
    widths = (64, 128, 256, 512, 1024)
    for index, (width, count) in enumerate(zip(widths, (1, 2, 8, 8, 4), strict=True), 1):
        stage = OrderedDict[str, nn.Module](conv=Convolution(width // 2, width, 3, stride=2))
        for block in range(count):
            stage[f"res{block}"] = _Residual(width)
        parts[f"conv_res_block{index}"] = nn.Sequential(stage)
    steps = list(parts)
    return Backbone(name, parts, steps=steps, taps=steps[2:], channels=widths[1:], end=("fc.",))


@final
class Convolution(nn.Module):
    """Convolution, batch norm and leaky ReLU: a building block of Darknet and YOLOv3."""

    def __init__(self, inside: int, outside: int, size: int, *, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inside, outside, size, stride, size // 2, bias=False)
        self.bn = nn.BatchNorm2d(outside)
        nn.init.kaiming_normal_(self.conv.weight, a=0.1, mode="fan_out")

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d i j"]:
        return nn.functional.leaky_relu(self.bn(self.conv(x)), 0.1)


@final
class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = Convolution(width, width // 2, 1)
        self.conv2 = Convolution(width // 2, width, 3)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        return x + self.conv2(self.conv1(x))
