"""Comparison of scanners and their poses on the same heaps of parts."""

from .choosing import Row, choose, sentences
from .judging import Fate
from .running import run_design
from .setting import Setting, settings_of
from .study import DesignSpec, design_schema, read_design
from .table import rows_of, write_design

__all__ = [
    "DesignSpec",
    "Fate",
    "Row",
    "Setting",
    "choose",
    "design_schema",
    "read_design",
    "rows_of",
    "run_design",
    "sentences",
    "settings_of",
    "write_design",
]
