"""Export finished datasets to training formats, point clouds, ROS 2 bags, rerun and pose demos."""

from .formats import export
from .options import FORMATS, Options
from .record import read_record
from .split import Split, parse_shares

__all__ = [
    "FORMATS",
    "Options",
    "Split",
    "export",
    "parse_shares",
    "read_record",
]
