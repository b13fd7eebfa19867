"""Export finished datasets to COCO, YOLO, BOP shards, WebDataset, Parquet and point clouds."""

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
