"""Scanners by name: one file each, in its maker's words, with a source beside each number."""

from .entry import NAMES, SHELF, Claims, ShelfEntry, no_rig, shelf_entry
from .measured import MEASURED, Measured, measured

__all__ = [
    "MEASURED",
    "NAMES",
    "SHELF",
    "Claims",
    "Measured",
    "ShelfEntry",
    "measured",
    "no_rig",
    "shelf_entry",
]
