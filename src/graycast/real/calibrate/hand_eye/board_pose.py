"""The pose of a board in one scan, from its corners in the picture and their depth."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from ....base.frames import transform_points
from ....rig.optics import Optics, project, rays
from ..board import Board, CalibrationError
from ..corners import MIN_CORNERS, disc, find_corners, read_at
from .motion import moved

FINE = 1e4  # Inverse depth is read in this share of itself, about the noise of a good scanner.
DISC_VARIANCE = 4.0  # n times the variance of a quadratic in the middle of a disc of n pixels
LEAST_PX, LEAST_SHARE = 1e-4, 1e-7  # These are the least standard deviations, of pixel and depth.
OUTLIER = 5.0  # A corner or a depth beyond this many robust standard deviations is left out.
ROUNDS = 3
MOST_RATIO = 0.1  # Depth and size of a board may differ by this share of its distance.
Masks = tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]  # used corners, used depths
DIFFERENCE = 1e-6  # step of derivatives [rad] and [m]
MOST_STEPS, TINY = 20, 1e-11  # Gauss-Newton steps, and the least step [rad] and [m].


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardScan:
    """Corners of a board in one scan; `depth_m` and its `sigma_m` are NaN where there is none."""

    name: str
    point_m: Float[np.ndarray, "n 3"]  # in the board's frame
    camera_px: Float[np.ndarray, "n 2"]
    depth_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPose:
    """Pose of a board, and the covariance of its motion in the board's frame (see `motion`)."""

    name: str
    T_cam_board: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    corners: int
    rms_px: float
    depth_rms_m: float  # NaN without depth


def scan_board(
    name: str,
    picture: Shaped[np.ndarray, "h w"],
    depth_m: Float[np.ndarray, "h w"] | None,
    sigma_m: Float[np.ndarray, "h w"] | None,
    camera: Optics,
    board: Board,
) -> BoardScan:
    """Measure the corners of a board and their depth.

    On a plane, inverse depth is a linear function of the undistorted pixel, so the inverse depth at
    a corner is read like a projector column there. Without `sigma_m`, depths have equal weights.

    Raises:
        CalibrationError: the picture does not show the board, or shows too little of it.
    """
    corners = find_corners(picture, board)
    n = len(corners.id)
    corner_depth_m, corner_sigma_m = np.full(n, np.nan), np.full(n, np.nan)
    if depth_m is not None and np.isfinite(depth_m).any():
        middle_m = float(np.nanmedian(depth_m))
        code = (FINE * middle_m / depth_m).astype(np.float64)
        spread = np.full(code.shape, 1e-4 * middle_m) if sigma_m is None else sigma_m
        sigma = np.where(np.isfinite(code), spread * FINE * middle_m / np.square(depth_m), np.nan)
        for i in range(n):
            at = corners.position_px[i]
            pixel = disc(at, corners.px_per_square[i], *code.shape)
            value, _ = read_at(at, pixel, code, sigma)
            if np.isfinite(value):
                corner_depth_m[i] = FINE * middle_m / value
                own = sigma[pixel[:, 1], pixel[:, 0]]
                per_code_m = corner_depth_m[i] / value
                typical = float(np.nanmedian(own)) / np.sqrt(np.isfinite(own).sum())
                corner_sigma_m[i] = np.sqrt(DISC_VARIANCE) * typical * per_code_m
    return BoardScan(
        name=name,
        point_m=board.corners_m[corners.id],
        camera_px=corners.position_px,
        depth_m=corner_depth_m,
        sigma_m=corner_sigma_m,
    )


def board_poses(scans: Sequence[BoardScan], camera: Optics) -> tuple[BoardPose, ...]:
    """Fit the pose of the board in each scan to corners and depth.

    The standard deviation of corners, and the factor of the depths' own standard deviations, are
    those of the residuals of all scans together. Their neighbours' errors are not independent, so
    the stated standard deviations alone would be too small.
    """
    sigma_px, factor = 0.05, 1.0
    T_cam_board = [_start(scan, camera) for scan in scans]
    used = [(np.ones(len(s.point_m), dtype=bool), np.isfinite(s.depth_m)) for s in scans]
    for step in range(ROUNDS):
        T_cam_board = [
            _fit(scan, camera, T, sigma_px, factor, *use)
            for scan, T, use in zip(scans, T_cam_board, used, strict=True)
        ]
        off = [_residuals(s, camera, T) for s, T in zip(scans, T_cam_board, strict=True)]
        if step == 0:
            used = [_inliers(each, use) for each, use in zip(off, used, strict=True)]
        squares_px, squares = (
            sum(
                float(np.square(each[k][use[k]]).sum()) for each, use in zip(off, used, strict=True)
            )
            for k in (0, 1)
        )
        count_px = sum(2 * int(use[0].sum()) for use in used)
        count = sum(int(use[1].sum()) for use in used)
        rest = 1 - 6 * len(scans) / (count_px + count)  # share of degrees of freedom
        sigma_px = max(np.sqrt(squares_px / count_px / rest), LEAST_PX)
        factor = max(np.sqrt(squares / max(count, 1) / rest), LEAST_SHARE)
    poses = []
    for scan, T, use in zip(scans, T_cam_board, used, strict=True):
        px, _ = _residuals(scan, camera, T)
        off_m = (scan.depth_m - transform_points(T, scan.point_m)[:, 2])[use[1]]
        poses.append(
            BoardPose(
                name=scan.name,
                T_cam_board=T,
                covariance=pose_covariance(scan, camera, T, sigma_px, factor, use),
                corners=int(use[0].sum()),
                rms_px=float(np.sqrt(np.square(px[use[0]]).sum(axis=1).mean())),
                depth_rms_m=float(np.sqrt(np.square(off_m).mean())) if len(off_m) else np.nan,
            )
        )
    return tuple(poses)


def pose_covariance(
    scan: BoardScan,
    camera: Optics,
    T_cam_board: Float[np.ndarray, "4 4"],
    sigma_px: float,
    factor: float = 1.0,
    used: Masks | None = None,
) -> Float[np.ndarray, "6 6"]:
    """Return the covariance of the board's motion; `used` has masks of corners and of depths."""
    used = used or (np.ones(len(scan.point_m), dtype=bool), np.isfinite(scan.depth_m))
    J = _weighted(scan, camera, T_cam_board, sigma_px, factor, *used)[1]
    return np.linalg.inv(J.T @ J)


def _start(scan: BoardScan, camera: Optics) -> Float[np.ndarray, "4 4"]:
    """Return the pose by OpenCV; of its two solutions for a plane, the one that depth prefers."""
    xy = np.ascontiguousarray(rays(camera, scan.camera_px)[:, :2])
    _, turns, places, _ = cv2.solvePnPGeneric(
        np.ascontiguousarray(scan.point_m), xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    poses = []
    for turn, place in zip(turns, places, strict=True):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], place.ravel()
        poses.append(T)
    known = np.isfinite(scan.depth_m)
    if known.sum() < MIN_CORNERS or len(poses) < 2:
        return poses[0]

    def tilt_misfit(T: Float[np.ndarray, "4 4"]) -> float:
        ratio = transform_points(T, scan.point_m)[known, 2] / scan.depth_m[known]
        return float(np.std(ratio))

    return min(poses, key=tilt_misfit)


def depth_ratio(scans: Sequence[BoardScan], camera: Optics) -> float:
    """Return the board's depth over the distance by the size of its squares; NaN without depth.

    Raises:
        CalibrationError: the unit of depth or the length of the squares is wrong.
    """
    ratio = [
        np.nanmedian(scan.depth_m / transform_points(_start(scan, camera), scan.point_m)[:, 2])
        for scan in scans
        if np.isfinite(scan.depth_m).sum() >= MIN_CORNERS
    ]
    if not ratio:
        return np.nan
    typical = float(np.median(ratio))
    if abs(np.log(typical)) > MOST_RATIO:
        raise CalibrationError(
            f"the depth of the board is {typical:.4g} times the distance at which its squares have "
            "their size in the picture: correct the side of a square in --board, the intrinsics or "
            "the unit of depth (--scale)"
        )
    return typical


def _residuals(scan: BoardScan, camera: Optics, T: Float[np.ndarray, "*k 4 4"]):
    """Return the residuals of corners [px], and those of depths in their standard deviations."""
    point_m = scan.point_m @ T[..., :3, :3].swapaxes(-1, -2) + T[..., None, :3, 3]
    depth = (scan.depth_m - point_m[..., 2]) / scan.sigma_m
    return scan.camera_px - project(camera, point_m), depth


def _inliers(residual: tuple[np.ndarray, np.ndarray], used: Masks) -> Masks:
    """Return masks of the corners and of the depths that agree with the board's plane."""
    (px, share), (corner, depth) = residual, used
    off_px = np.linalg.norm(px, axis=1)
    corner = corner & (off_px <= OUTLIER * max(float(np.median(off_px)), LEAST_PX))
    if depth.any():
        off = np.abs(share)
        depth = depth & (off <= OUTLIER * max(1.5 * float(np.median(off[depth])), LEAST_SHARE))
    return corner, depth


def _fit(scan: BoardScan, camera: Optics, T, sigma_px: float, factor: float, corner, depth):
    """Return the pose after Gauss-Newton steps."""
    for _ in range(MOST_STEPS):
        residual, J = _weighted(scan, camera, T, sigma_px, factor, corner, depth)
        step = -np.linalg.lstsq(J, residual, rcond=None)[0]
        T = moved(T, step)
        if np.abs(step).max() < TINY:
            break
    return T


def _weighted(scan: BoardScan, camera: Optics, T, sigma_px: float, factor: float, corner, depth):
    """Return residuals in standard deviations, and their derivatives by central differences."""
    steps = DIFFERENCE * np.vstack([np.zeros(6), np.eye(6), -np.eye(6)])
    px, share = _residuals(scan, camera, moved(np.broadcast_to(T, (13, 4, 4)), steps))
    px = px[:, corner].reshape(len(px), -1) / sigma_px
    rows = np.hstack([px, share[:, depth] / factor])
    return rows[0], (rows[1:7] - rows[7:]).T / (2 * DIFFERENCE)
