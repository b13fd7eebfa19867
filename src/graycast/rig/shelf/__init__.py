"""Scanners by name: one file each, in its maker's words, with a source beside each number."""

from .entry import MEASURED, NAMES, SHELF, ShelfEntry, ShelfFigures, measured, no_rig, shelf_entry

__all__ = [
    "MEASURED",
    "NAMES",
    "SHELF",
    "ShelfEntry",
    "ShelfFigures",
    "measured",
    "no_rig",
    "shelf_entry",
]
