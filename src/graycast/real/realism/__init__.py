"""What real depth maps have and perfect ones lack, measured: gaps, noise, steps, islands."""

from .depth_curves import draw_realism
from .depth_maps import read_perfect, read_scans
from .measure import Measurement, measure_all, measure_scan, pool
from .realism_record import RECORD_FILE, Realism, read_record, write_record
from .record_table import table
from .scan import DepthScan
from .two_sample import TwoSample, sensor_auc, two_sample_test
from .two_sample_page import two_sample_table, write_two_sample

__all__ = [
    "RECORD_FILE",
    "DepthScan",
    "Measurement",
    "Realism",
    "TwoSample",
    "draw_realism",
    "measure_all",
    "measure_scan",
    "pool",
    "read_perfect",
    "read_record",
    "read_scans",
    "sensor_auc",
    "table",
    "two_sample_table",
    "two_sample_test",
    "write_record",
    "write_two_sample",
]
