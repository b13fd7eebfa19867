"""Scanners by name: one file each, in its maker's words, with a source beside each number."""

from .entry import SHELF, Claims, ShelfEntry, refusal, shelf_entry
from .measured import MEASURED, Measured, measured

__all__ = [
    "MEASURED",
    "SHELF",
    "Claims",
    "Measured",
    "ShelfEntry",
    "measured",
    "refusal",
    "shelf_entry",
]
