"""One fit of the scanner's pose, of the board's pose, and of the scatter of the robot's poses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ....base.frames import inverse, rigid
from .board_pose import BoardPose
from .motion import adjoint, motion_between, motion_of_point, moved

Mount = Literal["in-hand", "to-hand"]
USUAL = (1e-3, 1e-3)  # The scatter [rad] and [m] of robot poses before it is estimated.
LEAST = 1e-8  # The least scatter, in the same units.
ROUNDS = 3
MOST_STEPS, TINY = 10, 1e-12  # Gauss-Newton steps, and the least step [rad] and [m].
Weights = Float[np.ndarray, "n 6 6"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """Robot poses with the boards that the scanner measured there.

    The unknowns are the frames p at the robot's base and q at its tool: `T_base_tool` is
    `T_base_p @ T_p_q @ T_q_tool`. With the mount "in-hand", p is the board and q the camera; with
    "to-hand", p is the camera and q the board. `covariance` is that of a motion of `T_p_q`.
    """

    mount: Mount
    names: tuple[str, ...]
    T_base_tool: Float[np.ndarray, "n 4 4"]
    T_p_q: Float[np.ndarray, "n 4 4"]
    covariance: Weights

    def only(self, keep: np.ndarray) -> "Views":
        index = np.arange(len(self.names))[keep]
        return replace(
            self,
            names=tuple(self.names[i] for i in index),
            T_base_tool=self.T_base_tool[index],
            T_p_q=self.T_p_q[index],
            covariance=self.covariance[index],
        )

    def turned(self, T_board: Float[np.ndarray, "n 4 4"]) -> "Views":
        """Return the same views with motions of the board that its picture does not show."""
        if self.mount == "in-hand":
            return replace(self, T_p_q=inverse(T_board) @ self.T_p_q)
        A = adjoint(inverse(T_board))
        C = A @ self.covariance @ A.swapaxes(1, 2)
        return replace(self, T_p_q=self.T_p_q @ T_board, covariance=C)


def views_of(
    boards: Sequence[BoardPose], T_base_tool: Float[np.ndarray, "n 4 4"], mount: Mount
) -> Views:
    """Return the views for the poses of a board in the camera frame."""
    T_cam_board = np.array([board.T_cam_board for board in boards])
    covariance = np.array([board.covariance for board in boards])
    if mount == "in-hand":
        A = adjoint(T_cam_board)
        T_cam_board, covariance = inverse(T_cam_board), A @ covariance @ A.swapaxes(1, 2)
    return Views(
        mount=mount,
        names=tuple(board.name for board in boards),
        T_base_tool=T_base_tool,
        T_p_q=T_cam_board,
        covariance=covariance,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEye:
    """Result of the fit.

    `T_robot_cam` is the camera in the frame that carries it: `T_tool_cam` for the mount "in-hand",
    `T_base_cam` for "to-hand". `T_other_board` is `T_base_board` or `T_tool_board`. `covariance` is
    that of the motions of both, camera first, each in the frame from which it maps. `residual` has
    each view's motion of the tool from the stated pose to the fitted one, and `left_out` the
    same if the view is not in the fit. `scatter` is the standard deviation of robot poses, each
    angle [rad] and each coordinate [m].
    """

    mount: Mount
    names: tuple[str, ...]
    T_robot_cam: Float[np.ndarray, "4 4"]
    T_other_board: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "12 12"]
    residual: Float[np.ndarray, "n 6"]
    left_out: Float[np.ndarray, "n 6"]
    scatter: tuple[float, float]

    def point_covariance(self, point_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """Return the covariance [m^2], by the fit's error, of a point that the camera measures."""
        G = motion_of_point(point_m)
        return G @ self.covariance[:6, :6] @ G.T


def residuals(
    views: Views, X: Float[np.ndarray, "4 4"], Y: Float[np.ndarray, "*k 4 4"]
) -> Float[np.ndarray, "n 6"]:
    """Return motions of the tool from the stated to the fitted poses; X: camera, Y: board."""
    T_base_p, T_tool_q = (Y, X) if views.mount == "in-hand" else (X, Y)
    return motion_between(views.T_base_tool, T_base_p @ views.T_p_q @ inverse(T_tool_q))


def fit_hand_eye(views: Views) -> HandEye:
    """Fit all unknowns by least squares, with the covariance of each measured pose.

    A pose and its covariance represent the corners and depths of a view, which is the same as a fit
    of all corners and depths together up to the second order of noise. The robot's own scatter is
    unknown: it adds to the covariance, and is estimated by restricted maximum likelihood.

    Source: H. D. Patterson and R. Thompson, "Recovery of inter-block information when block sizes
    are unequal", Biometrika 1971.
    """
    (X, Y), scatter = first_guess(views), USUAL
    for _ in range(ROUNDS):
        X, (Y,) = refined(views, X, Y[None], weights_of(views, X, Y, scatter))
        scatter = _scatter(views, X, Y)
    W = weights_of(views, X, Y, scatter)
    X, (Y,) = refined(views, X, Y[None], W)
    e, J = residuals(views, X, Y), _jacobian(views, X, Y)
    own = information_of(views, X, Y, scatter)
    information = own.sum(axis=0)
    step = np.linalg.solve(information - own, J.swapaxes(1, 2) @ W @ e[..., None])
    return HandEye(
        mount=views.mount,
        names=views.names,
        T_robot_cam=X,
        T_other_board=Y,
        covariance=np.linalg.inv(information),
        residual=e,
        left_out=e + (J @ step)[..., 0],
        scatter=scatter,
    )


def first_guess(views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses of camera and board in closed form, from the motions between all views.

    A motion of the tool and the measured motion turn by the same angle about one axis, which gives
    the rotation; the lengths of the motions then give the position. The solvers of OpenCV 4 are
    not in OpenCV 5.

    Source: F. Park and B. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean
    group", IEEE Transactions on Robotics and Automation 1994.
    """
    i, j = np.triu_indices(len(views.names), 1)
    A, B = (inverse(T[i]) @ T[j] for T in (views.T_base_tool, views.T_p_q))
    tool, measured = (Rotation.from_matrix(T[:, :3, :3]).as_rotvec() for T in (A, B))
    U, _, Vt = np.linalg.svd(tool.T @ measured)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    lengths = (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel()
    place = np.linalg.lstsq((A[:, :3, :3] - np.eye(3)).reshape(-1, 3), lengths, rcond=None)[0]
    T_tool_q = rigid(R, place)
    T_base_p = mean_pose(views.T_base_tool @ T_tool_q @ inverse(views.T_p_q))
    return (T_tool_q, T_base_p) if views.mount == "in-hand" else (T_base_p, T_tool_q)


def mean_pose(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the mean rotation with the median position."""
    rotation = Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix()
    return rigid(rotation, np.median(T[:, :3, 3], axis=0))


def weights_of(views: Views, X, Y, scatter: tuple[float, float]) -> Weights:
    """Return the inverse covariance of each view's residual."""
    A = adjoint(X if views.mount == "in-hand" else Y)
    robot = np.diag(np.repeat(np.square(scatter), 3))
    return np.linalg.inv(A @ views.covariance @ A.T + robot)


def refined(
    views: Views,
    X: Float[np.ndarray, "4 4"],
    boards: Float[np.ndarray, "boards 4 4"],
    weights: Weights,
    group: Int[np.ndarray, " n"] | None = None,
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "boards 4 4"]]:
    """Return the camera's pose and those of the boards after Gauss-Newton steps.

    Args:
        boards: one start for each group of views.
        group: the number of each view's board; None if there is one board.
    """
    index = np.zeros(len(views.names), dtype=np.intp) if group is None else group
    for _ in range(MOST_STEPS):
        e, both = residuals(views, X, boards[index]), _jacobian(views, X, boards[index])
        by_pose = np.zeros((len(e), 6, 1 + len(boards), 6))
        by_pose[:, :, 0] = both[..., :6]
        by_pose[np.arange(len(e)), :, 1 + index] = both[..., 6:]
        J = by_pose.reshape(len(e), 6, -1)
        JW = J.swapaxes(1, 2) @ weights
        information = (JW @ J).sum(axis=0)
        step = -np.linalg.solve(information, (JW @ e[..., None]).sum(axis=0)).reshape(-1, 6)
        X = moved(X, step[0])
        boards = moved(boards, step[1:])
        if np.abs(step).max() < TINY:
            break
    return X, boards


def information_of(
    views: Views, X, Y, scatter: tuple[float, float]
) -> Float[np.ndarray, "n 12 12"]:
    """Return what each view adds to the inverse covariance of the motions of camera and board."""
    J = _jacobian(views, X, Y)
    return J.swapaxes(1, 2) @ weights_of(views, X, Y, scatter) @ J


def _jacobian(views: Views, X, Y) -> Float[np.ndarray, "n 6 12"]:
    """Return the derivatives of the residuals by motions of camera and board."""
    Q = X if views.mount == "in-hand" else Y
    by_p = adjoint(Q @ inverse(views.T_p_q))
    by_q = np.broadcast_to(-adjoint(Q), by_p.shape)
    pair = (by_q, by_p) if views.mount == "in-hand" else (by_p, by_q)
    return np.concatenate(pair, axis=2)


def _scatter(views: Views, X, Y) -> tuple[float, float]:
    """Return the scatter of robot poses that makes the residuals most probable."""
    e, J = residuals(views, X, Y)[..., None], _jacobian(views, X, Y)

    def cost(log_scatter) -> float:
        W = weights_of(views, X, Y, tuple(np.exp(log_scatter)))
        JW = J.swapaxes(1, 2) @ W
        information = (JW @ J).sum(axis=0)
        r = e - J @ np.linalg.solve(information, (JW @ e).sum(axis=0))
        return float(
            np.linalg.slogdet(information)[1]
            - np.linalg.slogdet(W)[1].sum()
            + (r.swapaxes(1, 2) @ W @ r).sum()
        )

    spread = np.sqrt(np.mean(np.square(e[..., 0].reshape(-1, 2, 3)), axis=(0, 2)))
    low, high = np.log(LEAST), np.log(1.0)
    start = np.clip(np.log(np.maximum(spread, LEAST)), low, high)
    simplex = np.array([start, start - [1, 0], start - [0, 1]])
    fit = minimize(cost, start, method="Nelder-Mead", bounds=[(low, high)] * 2,
                   options={"initial_simplex": np.clip(simplex, low, high), "xatol": 0.01,
                            "fatol": 1e-3})  # fmt: skip
    rad, m = np.exp(fit.x)
    return float(rad), float(m)
