"""A rig from pictures of a board in several poses, the projector as an inverse camera."""

from .board import Board, CalibrationError, parse_board
from .board_stacks import describe_calibration, read_view
from .calibration import Calibration, ViewResidual, calibrate_rig, epipolar_distance_px
from .corners import Corners, find_corners
from .observing import BoardView
from .projector_corners import ProjectorCorners, projector_corners

__all__ = [
    "Board",
    "BoardView",
    "Calibration",
    "CalibrationError",
    "Corners",
    "ProjectorCorners",
    "ViewResidual",
    "calibrate_rig",
    "describe_calibration",
    "epipolar_distance_px",
    "find_corners",
    "parse_board",
    "projector_corners",
    "read_view",
]
