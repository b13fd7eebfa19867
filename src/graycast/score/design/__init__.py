"""Comparison of scanners and their poses on the same heaps of parts."""

from .choosing import SettingFigures, choose, sentences
from .design_run import run_design
from .design_tables import describe_design, rows_of, write_design
from .point_fates import Fate
from .setting import Setting, settings_of
from .study import DesignSpec, design_schema, read_design

__all__ = [
    "DesignSpec",
    "Fate",
    "Setting",
    "SettingFigures",
    "choose",
    "describe_design",
    "design_schema",
    "read_design",
    "rows_of",
    "run_design",
    "sentences",
    "settings_of",
    "write_design",
]
