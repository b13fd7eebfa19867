"""Training examples, read in the same form from a dataset and from its exports."""

from ..read.example import Example
from .sources import Examples, open_examples

__all__ = ["Example", "Examples", "open_examples"]
