"""Coded light: the frames that a projector shows, and the codes made of them.

frame  one picture of a code; it also describes the pictures of real scanners
code   codes as lists of frames, and the functions that make them
spec   a code by its name and parameters, for a projector of any size
"""

from .code import (
    Code,
    gray,
    gray_line_shift,
    gray_phase,
    micro_phase,
    multi_frequency,
    write_pngs,
    xor_gray,
)
from .frame import AXES, Axis, Frame, gray_from_binary, level_share
from .spec import CODECS, CodeSpec

__all__ = [
    "AXES",
    "CODECS",
    "Axis",
    "Code",
    "CodeSpec",
    "Frame",
    "gray",
    "gray_from_binary",
    "gray_line_shift",
    "gray_phase",
    "level_share",
    "micro_phase",
    "multi_frequency",
    "write_pngs",
    "xor_gray",
]
