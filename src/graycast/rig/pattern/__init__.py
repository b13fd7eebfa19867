"""Coded light: the frames that a projector shows, and the codes made of them."""

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
