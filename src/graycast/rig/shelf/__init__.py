"""Scanners by name: each has a file in its maker's terms, with a source for each number."""

from .entry import MEASURED, NAMES, SHELF, ShelfEntry, ShelfFigures, measured, no_rig, shelf_entry
from .sources import LEGEND, class_of, source_lines, stated_numbers

__all__ = [
    "LEGEND",
    "MEASURED",
    "NAMES",
    "SHELF",
    "ShelfEntry",
    "ShelfFigures",
    "class_of",
    "measured",
    "no_rig",
    "shelf_entry",
    "source_lines",
    "stated_numbers",
]
