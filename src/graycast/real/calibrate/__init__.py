"""Calibration of a rig from pictures of a board; the projector is treated as an inverse camera."""

from .board import parse_board
from .calibration import calibrate_rig, describe_calibration
from .observing import read_view

__all__ = ["calibrate_rig", "describe_calibration", "parse_board", "read_view"]
