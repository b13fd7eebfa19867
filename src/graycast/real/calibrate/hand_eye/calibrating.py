"""A hand-eye calibration from scans: checks, the fit, and views left out of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ....base.frames import transform_points
from ....rig.optics import Optics
from ..board import Board, CalibrationError
from .board_pose import BoardPose, BoardScan, board_poses, depth_ratio
from .fitting import HandEye, Mount, Views, fit_hand_eye, views_of
from .mistakes import MIN_VIEWS, board_turns, fit_turns, refuse_mistakes, refuse_one_axis
from .robot_poses import RobotPoses

GOOD_VIEWS, GOOD_ERROR_M, GOOD_RATIO = 10, 1e-3, 0.005
BLURRED_PX = 5.0  # A board whose residual exceeds this many medians is left out.
OUTLIER, OUTLIER_M = 6.0, 1e-4  # An outlier exceeds this many medians and this misfit.
MINORITY = 1 / 3  # A larger share of views is never left out, because it may be right.


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """A fit with the boards that it used, in the order of its views.

    `point_m` is the middle of the boards in the camera frame, where `error_m` holds: the RMS error
    in the robot's frame, from the calibration alone, of a point that the scanner measures there.
    """

    fit: HandEye
    boards: tuple[BoardPose, ...]
    point_m: Float[np.ndarray, "3"]
    error_m: float
    left_out: dict[str, str]
    warnings: tuple[str, ...]


def calibrate_hand_eye(
    scans: Sequence[BoardScan], poses: RobotPoses, board: Board, camera: Optics, *, mount: Mount
) -> Calibrated:
    """Calibrate from scans of a board and one robot pose for each of them.

    Raises:
        CalibrationError: there are too few scans, the poses do not determine the result, or they
            have one of the mistakes of `mistakes`.
    """
    _refuse_few(len(scans))
    ratio = depth_ratio(scans, camera)
    boards = board_poses(scans, camera)
    views = views_of(boards, poses.T_base_tool, mount)
    rms_px = np.array([one.rms_px for one in boards])
    good = rms_px <= BLURRED_PX * max(float(np.median(rms_px)), 0.02)
    left_out = {
        boards[i].name: f"its corners fit the board within {rms_px[i]:.2f} px only, the median "
        f"scan within {np.median(rms_px):.2f} px"
        for i in np.flatnonzero(~good)
    }
    views = views.only(good)
    _refuse_few(len(views.names))
    refuse_one_axis(views)
    turns = board_turns(board)
    fitted = fit_turns(views, turns)
    readings = {name: T[good] for name, T in poses.readings.items()}
    refuse_mistakes(views, fitted, turns, readings)
    fit, more = _fit_without_outliers(fitted[0])
    used = tuple(one for one in boards if one.name in fit.names)
    middle_m = board.corners_m.mean(axis=0)
    point_m = np.mean([transform_points(one.T_cam_board, middle_m) for one in used], axis=0)
    error_m = float(np.sqrt(np.trace(fit.point_covariance(point_m))))
    return Calibrated(
        fit=fit,
        boards=used,
        point_m=point_m,
        error_m=error_m,
        left_out=left_out | more,
        warnings=tuple(_warnings(fit, error_m, ratio)),
    )


def _refuse_few(count: int) -> None:
    if count < MIN_VIEWS:
        raise CalibrationError(
            f"{count} scans show the board, and at least {MIN_VIEWS} are needed: add scans from "
            f"other poses; {GOOD_VIEWS} or more are good"
        )


def _fit_without_outliers(views: Views) -> tuple[HandEye, dict[str, str]]:
    """Return the fit without the views that the others contradict, and the reasons."""
    most, left_out = int(MINORITY * len(views.names)), dict[str, str]()
    distance_m = float(np.median(np.linalg.norm(views.T_p_q[:, :3, 3], axis=1)))
    while True:
        fit = fit_hand_eye(views)
        off_m = np.linalg.norm(fit.left_out * np.repeat([distance_m, 1.0], 3), axis=1)
        worst, usual_m = int(off_m.argmax()), float(np.median(off_m))
        few = len(left_out) == most or len(views.names) <= MIN_VIEWS + 1
        if few or off_m[worst] <= max(OUTLIER * usual_m, OUTLIER_M):
            return fit, left_out
        left_out[views.names[worst]] = (
            f"its pose is {1e3 * off_m[worst]:.2f} mm from the fit of the others, the median scan "
            f"{1e3 * usual_m:.2f} mm: the pose may belong to another scan, or the robot or the "
            "board still moved"
        )
        views = views.only(np.arange(len(views.names)) != worst)


def _warnings(fit: HandEye, error_m: float, ratio: float):
    """Yield warnings about a result that is not reliable."""
    if len(fit.names) < GOOD_VIEWS:
        yield f"only {len(fit.names)} scans: {GOOD_VIEWS} or more make the result steady"
    if abs(ratio - 1) > GOOD_RATIO:
        yield (
            f"depth differs by {100 * (ratio - 1):+.2f} % from the distance that the size of the "
            "squares gives: measure the printed board, and check the intrinsics"
        )
    if error_m > GOOD_ERROR_M:
        yield (
            f"the calibration alone moves a measured point by {1e3 * error_m:.2f} mm (RMS): add "
            "poses, and turn the tool by 20 to 40 degrees about all axes"
        )
    if fit.scatter[1] > GOOD_ERROR_M:
        yield (
            f"robot and scanner disagree by {1e3 * fit.scatter[1]:.2f} mm along each axis, more "
            "than noise: look for a loose mount, a board that bends, a wrong lens or a robot that "
            "is not calibrated"
        )
