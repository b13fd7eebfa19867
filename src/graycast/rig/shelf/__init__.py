"""Scanners by name: one file each, in its maker's words, with a source beside each number."""

from .entry import MEASURED, NAMES, SHELF, ShelfEntry, ShelfFigures, measured, no_rig, shelf_entry
from .former_names import RigName, current_name, with_current_names

__all__ = [
    "MEASURED",
    "NAMES",
    "SHELF",
    "RigName",
    "ShelfEntry",
    "ShelfFigures",
    "current_name",
    "measured",
    "no_rig",
    "shelf_entry",
    "with_current_names",
]
