"""Scanners by name: one file each, in its maker's words, with a source beside each number."""

from .entry import NAMES, SHELF, Claims, ShelfEntry, no_rig, shelf_entry
from .measured import MEASURED, ShelfFigures, measured

__all__ = [
    "MEASURED",
    "NAMES",
    "SHELF",
    "Claims",
    "ShelfEntry",
    "ShelfFigures",
    "measured",
    "no_rig",
    "shelf_entry",
]
