"""Scanners by name: one file each, in its maker's words, with a source beside each number."""

from .entry import MEASURED, NAMES, SHELF, ShelfEntry, ShelfFigures, measured, no_rig, shelf_entry
from .former_names import RigName, current_name, with_current_names
from .sources import LEGEND, class_of, source_lines, stated_numbers

__all__ = [
    "LEGEND",
    "MEASURED",
    "NAMES",
    "SHELF",
    "RigName",
    "ShelfEntry",
    "ShelfFigures",
    "class_of",
    "current_name",
    "measured",
    "no_rig",
    "shelf_entry",
    "source_lines",
    "stated_numbers",
    "with_current_names",
]
