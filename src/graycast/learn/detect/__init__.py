"""Detectors: training on datasets and detection in pictures; needs `graycast[detect]`.

    networks, network             the names of the networks; their common interface
    encoding, training_pictures   the encoding of pictures as a network's input
    mask_rcnn, yolov3, solov2, yolov7, backbones, suppression   the networks
    run, training                 the folder of a training, and its loop
    detector, detecting, drawing  a trained detector, its use on pictures, and drawings
    onnx_file                     export of a detector for other programs

A public name is imported from its module at its first use, because the command line and the
encoding of a picture do not need PyTorch.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for type checkers and editors; `_MODULE` says the same to Python
    from .detecting import detect as detect
    from .detecting import pictures_of as pictures_of
    from .detector import Detector as Detector
    from .detector import load_detector as load_detector
    from .training import TrainSpec as TrainSpec
    from .training import train as train
    from .training_pictures import Augmentation as Augmentation

_MODULE = {
    "Augmentation": "training_pictures",
    "Detector": "detector",
    "TrainSpec": "training",
    "detect": "detecting",
    "load_detector": "detector",
    "pictures_of": "detecting",
    "train": "training",
}
__all__ = list(_MODULE)


def __getattr__(name: str) -> object:
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULE[name]}", __name__), name)
