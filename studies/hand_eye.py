"""Errors of hand-eye calibrations and of OpenCV's solvers, for docs/measurements/rigs.md.

python -m studies.hand_eye

A simulated robot shows a board to a scanner of the shelf. Each row is the RMS error over simulated
calibrations, in millimetres, of a point that the scanner measures in the middle of its range. The
solvers of OpenCV 4 get the same poses of the board. OpenCV 5 does not have them.
"""

import argparse
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from graycast.base.frames import inverse, rigid
from graycast.base.tables import markdown_table
from graycast.camera.scanner import preset
from graycast.real.calibrate import parse_board
from graycast.real.calibrate.hand_eye import predict
from graycast.real.calibrate.hand_eye.board_pose import board_poses
from graycast.real.calibrate.hand_eye.fitting import Mount, Views, fit_hand_eye, views_of
from graycast.real.calibrate.hand_eye.plan import CellNoise, Plan, noisy_scans

Pose = Float[np.ndarray, "4 4"]
Poses = Float[np.ndarray, "n 4 4"]
SOLVERS = ("Tsai", "Park", "Horaud", "Andreff", "Daniilidis")
BOARD = parse_board("chessboard:9x6:0.025")
RIG = preset("like-phoxi-m").rig
NOISE = CellNoise(corner_px=0.05, robot_rad=2e-4, robot_m=1e-4)
MOUNTS = ("in-hand", "to-hand")
TURNS = {
    "in-hand": ((0.1, 0.2, 0.3), (0.05, 0.02, 0.1), (3.0, 0.1, 0.2), (0.6, 0.1, 0.2)),
    "to-hand": ((2.8, 0.1, 0.2), (0.6, 0.1, 1.5), (0.3, 0.1, 0.2), (0.0, 0.0, 0.1)),
}


def pose(turn_rad: Sequence[float] | Float[np.ndarray, "3"], place_m: Sequence[float]) -> Pose:
    """Return a transform from a rotation vector and a position."""
    return rigid(Rotation.from_rotvec(turn_rad).as_matrix(), np.array(place_m, dtype=np.float64))


def boards_in_view(n: int, rng: np.random.Generator) -> Poses:
    """Return boards in the camera frame that are tilted in all directions."""
    middle, poses = BOARD.corners_m.mean(axis=0), []
    for _ in range(n):
        T = pose(np.append(rng.uniform(-0.5, 0.5, 2), rng.uniform(-1, 1)), (0, 0, 0))
        z_m = (RIG.near_m + RIG.far_m) / 2 * rng.uniform(0.95, 1.05)
        centre = z_m * np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.08, 0.08), 1.0])
        poses.append(rigid(T[:3, :3], centre - T[:3, :3] @ middle))
    return np.array(poses)


def cell(
    n: int, mount: Mount, *, seed: int, noise: CellNoise = NOISE, T_cam_board: Poses | None = None
) -> Plan:
    """Return a plan whose robot shows the board to the scanner in n poses."""
    if T_cam_board is None:
        T_cam_board = boards_in_view(n, np.random.default_rng(seed))
    turn, place, other, where = TURNS[mount]
    X, Y = pose(turn, place), pose(other, where)
    T = X @ T_cam_board @ inverse(Y)
    return Plan(
        mount=mount,
        rig=RIG,
        board=BOARD,
        T_base_tool=inverse(T) if mount == "in-hand" else T,
        T_robot_cam=X,
        T_other_board=Y,
        noise=noise,
    )


def opencv_pose(views: Views, solver: str) -> Pose:
    """Return the camera's pose in the frame that carries it, by a solver of OpenCV 4."""
    A, B = views.T_base_tool, inverse(views.T_p_q)
    if views.mount == "to-hand":
        A, B = inverse(A), views.T_p_q
    R, t = cv2.calibrateHandEye(
        A[:, :3, :3], A[:, :3, 3], B[:, :3, :3], B[:, :3, 3],
        method=getattr(cv2, f"CALIB_HAND_EYE_{solver.upper()}"),
    )  # fmt: skip
    return rigid(R, t.ravel())


def error_m(T_robot_cam: Pose, plan: Plan, point_m: Float[np.ndarray, "3"]) -> float:
    """Return the error of a measured point in the frame that carries the camera."""
    off = T_robot_cam - plan.T_robot_cam
    return float(np.linalg.norm(off[:3, :3] @ point_m + off[:3, 3]))


def errors_m(
    plan: Plan, runs: int, rng: np.random.Generator, solvers: Sequence[str] = SOLVERS
) -> Float[np.ndarray, "runs methods"]:
    """Return the errors of simulated calibrations: those of the fit, then those of the solvers."""
    point_m, rows = predict(plan).point_m, []
    for _ in range(runs):
        scans, T_base_tool = noisy_scans(plan, rng)
        views = views_of(board_poses(scans, RIG.camera), T_base_tool, plan.mount)
        poses = [fit_hand_eye(views).T_robot_cam, *(opencv_pose(views, name) for name in solvers)]
        rows.append([error_m(T, plan, point_m) for T in poses])
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--mount", choices=("in-hand", "to-hand"), default="in-hand")
    options = parser.parse_args()
    solvers = SOLVERS if hasattr(cv2, "calibrateHandEye") else ()
    rows = []
    for n in (5, 10, 20):
        for factor in (1, 4):
            noise = CellNoise(
                corner_px=NOISE.corner_px,
                robot_rad=factor * NOISE.robot_rad,
                robot_m=factor * NOISE.robot_m,
            )
            plan = cell(n, options.mount, seed=0, noise=noise)
            error = errors_m(plan, options.runs, np.random.default_rng(1), solvers)
            rms_mm = 1e3 * np.sqrt(np.mean(np.square(error), axis=0))
            values = [1e3 * predict(plan).error_m, *rms_mm]
            robot = f"{1e3 * noise.robot_m:g} mm, {np.degrees(noise.robot_rad):.3f} degrees"
            rows.append([str(n), robot, *(f"{value:.3f}" for value in values)])
    print(markdown_table(["poses", "noise of the robot", "predicted", "fit", *solvers], rows))


if __name__ == "__main__":
    main()
