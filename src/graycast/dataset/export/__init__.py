"""Finished datasets in the formats of other programs: COCO, YOLO, BOP's shards, clouds, tables."""

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
