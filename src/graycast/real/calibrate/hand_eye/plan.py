"""The error that poses of a robot will give, from the covariance of the fit, before any scan."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ....base.frames import inverse, rigid, transform_points
from ....rig.optics import in_picture, project
from ....rig.pair import Rig
from ..board import Board, CalibrationError
from ..corners import MIN_CORNERS
from .board_pose import BoardPose, BoardScan, board_poses, pose_covariance
from .fitting import Mount, fit_hand_eye, information_of, views_of
from .mistakes import MIN_VIEWS, refuse_one_axis
from .motion import motion_of_point, moved


@dataclass(frozen=True, slots=True, kw_only=True)
class CellNoise:
    """Standard deviations: corners and projector columns [px], robot poses [rad] and [m]."""

    corner_px: float
    robot_rad: float
    robot_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Poses of a tool from which a rig sees a board, in a cell that is not built yet.

    `T_robot_cam` and `T_other_board` are those of `HandEye`.
    """

    mount: Mount
    rig: Rig
    board: Board
    T_base_tool: Float[np.ndarray, "n 4 4"]
    T_robot_cam: Float[np.ndarray, "4 4"]
    T_other_board: Float[np.ndarray, "4 4"]
    noise: CellNoise

    def T_cam_board(self) -> Float[np.ndarray, "n 4 4"]:
        T = inverse(self.T_base_tool) if self.mount == "in-hand" else self.T_base_tool
        return inverse(self.T_robot_cam) @ T @ self.T_other_board

    def scans(self) -> tuple[BoardScan, ...]:
        """Return exact scans with the corners that both devices see; poses may see no corner.

        The noise of a depth is that of triangulation, `z^2 / (f b)` times that of a column.
        """
        camera, per_px = self.rig.camera, 1 / (self.rig.camera.fx_px * self.rig.baseline_m)
        scans = []
        for i, T in enumerate(self.T_cam_board()):
            point_m = transform_points(T, self.board.corners_m)
            lit = transform_points(inverse(self.rig.T_cam_proj), point_m)
            px = project(camera, point_m)
            visible = in_picture(camera, px)
            visible &= in_picture(self.rig.projector, project(self.rig.projector, lit))
            z_m = point_m[visible, 2]
            scans.append(
                BoardScan(
                    name=f"pose {i + 1}",
                    point_m=self.board.corners_m[visible],
                    camera_px=px[visible],
                    depth_m=z_m,
                    sigma_m=self.noise.corner_px * np.square(z_m) * per_px,
                )
            )
        return tuple(scans)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Predicted errors: RMS [m] at the middle of the boards, and the covariance of `HandEye`.

    `without_m` has the error without each used pose, and `unused` the poses that see no board.
    """

    error_m: float
    without_m: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "12 12"]
    point_m: Float[np.ndarray, "3"]
    used: tuple[str, ...]
    unused: tuple[str, ...]


def predict(plan: Plan) -> Prediction:
    """Return the error of a calibration from these poses, in closed form.

    It is the covariance of weighted least squares at the true values, so no noise is sampled.

    Raises:
        CalibrationError: too few poses see the board, or they do not determine the result.
    """
    scans = plan.scans()
    used = [i for i, scan in enumerate(scans) if len(scan.point_m) >= MIN_CORNERS]
    if len(used) < MIN_VIEWS:
        raise CalibrationError(
            f"the scanner sees the board from {len(used)} of {len(scans)} poses, and at least "
            f"{MIN_VIEWS} are needed: move the poses so that the board is in both fields of view, "
            "or state camera and board with --guess"
        )
    T_cam_board = plan.T_cam_board()[used]
    boards = [
        BoardPose(
            name=scans[i].name,
            T_cam_board=T,
            covariance=pose_covariance(scans[i], plan.rig.camera, T, plan.noise.corner_px),
            corners=len(scans[i].point_m),
            rms_px=0.0,
            depth_rms_m=0.0,
        )
        for i, T in zip(used, T_cam_board, strict=True)
    ]
    views = views_of(boards, plan.T_base_tool[used], plan.mount)
    refuse_one_axis(views)
    scatter = (plan.noise.robot_rad, plan.noise.robot_m)
    middle_m = plan.board.corners_m.mean(axis=0)
    point_m = np.mean([transform_points(T, middle_m) for T in T_cam_board], axis=0)
    information = information_of(views, plan.T_robot_cam, plan.T_other_board, scatter)
    G = motion_of_point(point_m)

    def error_m(information: Float[np.ndarray, "12 12"]) -> float:
        return float(np.sqrt(np.trace(G @ np.linalg.inv(information)[:6, :6] @ G.T)))

    whole = information.sum(axis=0)
    return Prediction(
        error_m=error_m(whole),
        without_m=np.array([error_m(whole - own) for own in information]),
        covariance=np.linalg.inv(whole),
        point_m=point_m,
        used=tuple(board.name for board in boards),
        unused=tuple(scan.name for i, scan in enumerate(scans) if i not in used),
    )


def noisy_scans(
    plan: Plan, rng: np.random.Generator
) -> tuple[tuple[BoardScan, ...], Float[np.ndarray, "n 4 4"]]:
    """Return scans and stated robot poses with random errors, where enough of the board is seen."""
    noise, scans, poses = plan.noise, [], []
    for scan, T in zip(plan.scans(), plan.T_base_tool, strict=True):
        n = len(scan.point_m)
        if n < MIN_CORNERS:
            continue
        scans.append(
            BoardScan(
                name=scan.name,
                point_m=scan.point_m,
                camera_px=scan.camera_px + noise.corner_px * rng.normal(size=(n, 2)),
                depth_m=scan.depth_m + scan.sigma_m * rng.normal(size=n),
                sigma_m=scan.sigma_m,
            )
        )
        size = np.repeat([noise.robot_rad, noise.robot_m], 3)
        poses.append(moved(T, size * rng.normal(size=6)))
    return tuple(scans), np.array(poses)


def simulated_errors_m(
    plan: Plan, point_m: Float[np.ndarray, "3"], runs: int, rng: np.random.Generator
) -> Float[np.ndarray, " runs"]:
    """Return the errors of a measured point after calibrations from noisy scans."""
    errors = []
    for _ in range(runs):
        scans, T_base_tool = noisy_scans(plan, rng)
        fit = fit_hand_eye(views_of(board_poses(scans, plan.rig.camera), T_base_tool, plan.mount))
        off = fit.T_robot_cam - plan.T_robot_cam
        errors.append(np.linalg.norm(off[:3, :3] @ point_m + off[:3, 3]))
    return np.array(errors)


def middle_of_views(
    T_world_cam: Float[np.ndarray, "n 4 4"], board: Board, distance_m: float
) -> Float[np.ndarray, "4 4"]:
    """Return a board that faces the mean of the cameras, nearest to all of their axes.

    Axes that are nearly parallel meet far away, so the middle of the working range of each camera
    counts a little as well.
    """
    axis, eye = T_world_cam[:, :3, 2], T_world_cam[:, :3, 3]
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    pull = across + 0.01 * np.eye(3)
    goal = np.einsum("nij,nj->ni", pull, eye + distance_m * axis)
    middle = np.linalg.solve(pull.sum(axis=0), goal.sum(axis=0))
    R = Rotation.from_matrix(T_world_cam[:, :3, :3]).mean().as_matrix()
    return rigid(R, middle - R @ board.corners_m.mean(axis=0))
