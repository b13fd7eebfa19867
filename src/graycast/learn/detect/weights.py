"""Published weights taken into a network: a whole detector's, or its backbone's alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from ...base.errors import GraycastError
from .backbones import load_backbone
from .network import Network


def load_weights(network: Network, file: Path) -> None:
    """Take the weights of a file: another run's detector, or a backbone as its makers publish it.

    A detector's weights that have another shape, those of other classes, stay as they were drawn.

    Raises:
        GraycastError: the file is missing or damaged, or holds weights of another network.
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
    except Exception as error:  # unpickling raises whatever the bytes lead it to
        raise GraycastError(
            f"{file}: is damaged or is not a file of weights: download it again"
        ) from error
    if not tensors or not all(isinstance(value, torch.Tensor) for value in tensors.values()):
        raise GraycastError(
            f"{file}: holds no weights by name: give a published backbone, or detector.pt of "
            "another training"
        )
    return tensors
