"""Comparison of scanners and of scanner poses on the same heaps of parts."""

from .design_run import run_design
from .design_tables import describe_design, rows_of, write_design
from .setting import settings_of
from .study import read_design

__all__ = [
    "describe_design",
    "read_design",
    "rows_of",
    "run_design",
    "settings_of",
    "write_design",
]
