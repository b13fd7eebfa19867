"""Statistics of what real depth maps have and perfect ones lack: gaps, noise, flying pixels."""

from .depth_curves import draw_realism
from .depth_maps import read_scans
from .measure import measure_all, pool
from .realism_record import RECORD_FILE, read_record, write_record
from .record_table import table
from .scan import DepthScan
from .two_sample import TwoSample, two_sample_test
from .two_sample_files import two_sample_table, write_two_sample

__all__ = [
    "RECORD_FILE",
    "DepthScan",
    "TwoSample",
    "draw_realism",
    "measure_all",
    "pool",
    "read_record",
    "read_scans",
    "table",
    "two_sample_table",
    "two_sample_test",
    "write_record",
    "write_two_sample",
]
