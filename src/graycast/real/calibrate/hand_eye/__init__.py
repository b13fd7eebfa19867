"""The pose of a scanner on a robot, or next to it, from scans of a board and poses of the tool.

robot_poses     files of robot poses
scans           scans from a folder
motion          small motions of transforms
board_pose      the board's pose in a scan, from corners and depth
fitting         the fit of all views, with covariance and leave-one-out errors
mistakes        usual mistakes and their remedies; boards that look the same after a turn
calibrating     the calibration of scans and poses
plan            the error that poses will give, without scans
hand_eye_file   the result as YAML and as text
"""

from .board_pose import scan_board
from .calibrating import calibrate_hand_eye
from .hand_eye_file import describe_hand_eye, describe_prediction, read_guess, write_hand_eye
from .plan import CellNoise, Plan, middle_of_views, predict, simulated_errors_m
from .robot_poses import read_poses
from .scans import read_scans

__all__ = [
    "CellNoise",
    "Plan",
    "calibrate_hand_eye",
    "describe_hand_eye",
    "describe_prediction",
    "middle_of_views",
    "predict",
    "read_guess",
    "read_poses",
    "read_scans",
    "scan_board",
    "simulated_errors_m",
    "write_hand_eye",
]
