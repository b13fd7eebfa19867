"""A hand-eye calibration as a YAML file, as a table, and as the guess of a simulation."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from scipy.stats import t as student

from ....base.errors import ConfigError
from ....base.folder import write_whole
from ....base.frames import is_rigid
from ....base.settings import parse_yaml, read_text
from .calibrating import Calibrated
from .fitting import HandEye, Mount
from .plan import Plan, Prediction

KEYS: dict[Mount, tuple[str, str]] = {
    "in-hand": ("T_tool_cam", "T_base_board"),
    "to-hand": ("T_base_cam", "T_tool_board"),
}
NUMBERS = ("x_m", "y_m", "z_m", "rotation_x_rad", "rotation_y_rad", "rotation_z_rad")
HEAD = """\
# A hand-eye calibration by graycast rig hand-eye. T_a_b maps coordinates of frame b to frame a; the
# camera looks along z, x is right and y is down. Positions are in the frame a, and the rotations of
# the intervals are about the camera's axes. hand_eye_m and hand_eye_rad are keys of the section
# picking of graycast robot pick.
"""


def standard_deviations(fit: HandEye) -> Float[np.ndarray, " 6"]:
    """Return those of the camera's position [m] and of its rotations about its own axes [rad]."""
    R = fit.T_robot_cam[:3, :3]
    place = R @ fit.covariance[3:6, 3:6] @ R.T
    return np.sqrt(np.concatenate([np.diag(place), np.diag(fit.covariance[:3, :3])]))


def write_hand_eye(result: Calibrated, path: Path) -> None:
    """Write the transforms, their intervals and the residuals as YAML."""
    fit = result.fit
    camera, board = KEYS[fit.mount]
    sigma = standard_deviations(fit)
    half = float(student.ppf(0.975, 6 * len(fit.names) - 12)) * sigma
    middle = np.concatenate([fit.T_robot_cam[:3, 3], np.zeros(3)])
    content: dict[str, Any] = {
        "mount": fit.mount,
        camera: fit.T_robot_cam.tolist(),
        board: fit.T_other_board.tolist(),
        "interval_95": {
            name: [float(m - h), float(m + h)]
            for name, m, h in zip(NUMBERS, middle, half, strict=True)
        },
        "covariance": fit.covariance[:6, :6].tolist(),
        "error_at_gripper_m": result.error_m,
        "at_point_cam_m": result.point_m.tolist(),
        "residual_at_tool_m": _rms_m(fit.residual),
        "leave_one_out_at_tool_m": _rms_m(fit.left_out),
        "robot_scatter": {"each_axis_m": fit.scatter[1], "each_angle_rad": fit.scatter[0]},
        "hand_eye_m": result.error_m / np.sqrt(3).item(),
        "hand_eye_rad": float(np.sqrt(np.mean(np.square(sigma[3:])))),
        "scans": {
            name: {"residual_m": float(np.linalg.norm(e[3:])),
                   "leave_one_out_m": float(np.linalg.norm(other[3:]))}
            for name, e, other in zip(fit.names, fit.residual, fit.left_out, strict=True)
        },
        "left_out": result.left_out,
    }  # fmt: skip
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    write_whole(path, (HEAD + text).encode())


def _rms_m(motion: Float[np.ndarray, "n 6"]) -> float:
    return float(np.sqrt(np.square(motion[:, 3:]).sum(axis=1).mean()))


def read_guess(path: Path, mount: Mount) -> tuple[np.ndarray, np.ndarray | None]:
    """Read the poses of camera and board from such a file; None for a board that it lacks.

    Raises:
        ConfigError: the file has no pose of the camera for this mount, or a pose is not rigid.
    """
    content = parse_yaml(read_text(path), path)
    poses = []
    for key in KEYS[mount]:
        try:
            T = np.array(content[key], dtype=np.float64) if key in content else None
        except (TypeError, ValueError):
            T = np.zeros((4, 4))
        if T is not None and not is_rigid(T, 1e-3):
            raise ConfigError(f"{path}: {key} is not a rigid transform: give 4 x 4 numbers in m")
        poses.append(T)
    if poses[0] is None:
        raise ConfigError(f"{path}: has no {KEYS[mount][0]}, which --mount {mount} needs: add it")
    return poses[0], poses[1]


def describe_hand_eye(result: Calibrated) -> str:
    """Return a table of the scans, the pose of the camera with its intervals, and the errors."""
    fit = result.fit
    lines = ["scan: corners; RMS [px], of depth [mm]; residual and leave-one-out at the tool [mm]"]
    for board, e, other in zip(result.boards, fit.residual, fit.left_out, strict=True):
        depth = "none" if np.isnan(board.depth_rms_m) else f"{1e3 * board.depth_rms_m:.3f}"
        lines.append(
            f"  {board.name}: {board.corners}; {board.rms_px:.3f}, {depth}; "
            f"{1e3 * np.linalg.norm(e[3:]):.3f}, {1e3 * np.linalg.norm(other[3:]):.3f}"
        )
    lines += [
        f"all: residual at the tool {1e3 * _rms_m(fit.residual):.3f} mm, leave-one-out "
        f"{1e3 * _rms_m(fit.left_out):.3f} mm (RMS)",
        f"robot poses scatter by {1e3 * fit.scatter[1]:.3f} mm along and "
        f"{np.degrees(fit.scatter[0]):.3f} degrees about each axis",
        f"{KEYS[fit.mount][0]}:",
    ]
    lines += ["  " + " ".join(f"{value:10.6f}" for value in row) for row in fit.T_robot_cam]
    place, turn = np.split(standard_deviations(fit), 2)
    lines += [
        "standard deviations: position " + ", ".join(f"{1e3 * s:.3f}" for s in place) + " mm, "
        "rotation " + ", ".join(f"{np.degrees(s):.4f}" for s in turn) + " degrees",
        f"error at the gripper by the calibration alone: {1e3 * result.error_m:.3f} mm (RMS, for a "
        f"point at {result.point_m[2]:.3f} m from the camera)",
    ]
    return "\n".join(lines)


def describe_prediction(plan: Plan, prediction: Prediction) -> str:
    """Return the predicted error with that of each pose left out, and the unused poses."""
    lines = ["pose: predicted error at the gripper without it [mm]"]
    lines += [
        f"  {name}: {1e3 * error_m:.3f}"
        for name, error_m in zip(prediction.used, prediction.without_m, strict=True)
    ]
    if prediction.unused:
        lines.append(f"no board is in both fields of view: {', '.join(prediction.unused)}")
    lines.append(
        f"predicted error at the gripper with {len(prediction.used)} poses: "
        f"{1e3 * prediction.error_m:.3f} mm (RMS, for a point at {prediction.point_m[2]:.3f} m "
        f"from the camera; corners {plan.noise.corner_px:g} px, robot "
        f"{1e3 * plan.noise.robot_m:g} mm and {np.degrees(plan.noise.robot_rad):.3f} degrees)"
    )
    return "\n".join(lines)
