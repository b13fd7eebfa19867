"""Detectors trained on datasets, and what they find in pictures; needs `graycast[detect]`."""

from .detecting import Chosen, Looked, detect, pictures_of
from .detector import About, Detector, load_detector
from .encoding import Encoding
from .pictures import Augmentation
from .training import TrainSpec, train

__all__ = [
    "About",
    "Augmentation",
    "Chosen",
    "Detector",
    "Encoding",
    "Looked",
    "TrainSpec",
    "detect",
    "load_detector",
    "pictures_of",
    "train",
]
