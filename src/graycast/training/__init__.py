"""Examples for trainers, read alike from a dataset and from its exports."""

from ..dataset.example import Example
from .reading import Examples, open_examples

__all__ = ["Example", "Examples", "open_examples"]
