"""What real depth maps have and perfect ones lack, measured: gaps, noise, steps, islands."""

from .measure import Measurement, measure, pool
from .plots import draw_realism
from .reading import read_scans
from .record import RECORD_FILE, Realism, read_record, write_record
from .scan import Scan
from .table import table

__all__ = [
    "RECORD_FILE",
    "Measurement",
    "Realism",
    "Scan",
    "draw_realism",
    "measure",
    "pool",
    "read_record",
    "read_scans",
    "table",
    "write_record",
]
