"""Stacks of pictures from real scanners: description in YAML, decoding and results."""

from .averaging import Cells, join_pixels, meet_rays
from .decoding import Cloud, StackResult, decode_stack
from .description import (
    StackDescription,
    code_of,
    describe_code,
    describe_frames,
    describe_stack,
    read_description,
)
from .diagnosis import mirror_symptom
from .idle_settings import unread_settings
from .levels import MeasuredLevels, measure_levels
from .products import CODE, describe_result, write_ply, write_result

__all__ = [
    "CODE",
    "Cells",
    "Cloud",
    "MeasuredLevels",
    "StackDescription",
    "StackResult",
    "code_of",
    "decode_stack",
    "describe_code",
    "describe_frames",
    "describe_result",
    "describe_stack",
    "join_pixels",
    "measure_levels",
    "meet_rays",
    "mirror_symptom",
    "read_description",
    "unread_settings",
    "write_ply",
    "write_result",
]
