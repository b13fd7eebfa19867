"""Bundle adjustment: one fit of both devices, the pose between them and the poses of all boards."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...base.frames import inverse, rigid
from ...rig.optics import Optics, distort
from .board import CalibrationError

DEVICE = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
POSE = ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "x_m", "y_m", "z_m")
REWEIGHTINGS = 4
MOST_STEPS = 100  # Good views need about ten steps per fit.
NO_FIT = (
    "no camera and projector fit these views: decode each stack with graycast rig decode to see "
    "whether its code is right, and show the board in more different directions"
)
OUTLIER = 6.0  # A corner whose residual exceeds this many medians is an outlier.
RADIAL = ("k1", "k2", "k3")
DETERMINED = 5.0  # A device's last radial term must differ from 0 by this many standard deviations.
OUTLIER_FLOOR_PX = 0.05  # least median in that rule, so that no good corner is an outlier
LEAST_OF_VIEW = 4  # Fewer corners do not determine the pose of the board.


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """Corners of all views, one per row, with their positions in both devices."""

    view: Int[np.ndarray, " n"]
    point_m: Float[np.ndarray, "n 3"]  # in the board's frame
    camera_px: Float[np.ndarray, "n 2"]
    projector_px: Float[np.ndarray, "n 2"]
    per_camera_px: Float[np.ndarray, "n 2 2"]  # derivative of projector by camera pixels

    def only(self, keep: Bool[np.ndarray, " n"]) -> "Observations":
        return Observations(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def joined(parts: Sequence[Observations]) -> Observations:
    """Return the observations of all parts, one after another."""
    names = [f.name for f in fields(Observations)]
    return Observations(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjustment:
    """Result of the fit. Residuals are measured minus predicted positions (x, y) of observations.

    `residual_px` has the residuals in camera and projector, the latter without the camera's share
    (see `adjust`), and `sigma_px` their standard deviation in each device. `inlier` is a mask of
    the observations that were fitted. `deviation` has the standard deviation of each fitted number,
    such as "camera.fx_px", "projector.k1", "T_proj_cam.x_m" or "baseline_m". `undetermined` has the
    radial terms that were set to 0 because they do not differ significantly from 0, each with its
    previous value and standard deviation.
    """

    camera: Optics
    projector: Optics
    T_cam_proj: Float[np.ndarray, "4 4"]
    T_cam_board: Float[np.ndarray, "views 4 4"]
    camera_residual_px: Float[np.ndarray, "n 2"]
    projector_residual_px: Float[np.ndarray, "n 2"]
    residual_px: Float[np.ndarray, "n 2 2"]
    inlier: Bool[np.ndarray, " n"]
    sigma_px: Float[np.ndarray, " 2"]
    deviation: dict[str, float]
    undetermined: dict[str, tuple[float, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stands:
    """Result of a fit in which each group of views has its own pose between the devices.

    A stand is a pose between the devices. `number` has its six unknowns, and `information` is the
    inverse of their covariance if the lenses are known. `residual_px`, `inlier` and `sigma_px` are
    defined as in `Adjustment`.
    """

    T_cam_proj: Float[np.ndarray, "stands 4 4"]
    number: Float[np.ndarray, "stands 6"]
    information: Float[np.ndarray, "stands 6 6"]
    residual_px: Float[np.ndarray, "n 2 2"]
    inlier: Bool[np.ndarray, " n"]
    sigma_px: Float[np.ndarray, " 2"]


def adjust(
    obs: Observations,
    camera_size_px: tuple[int, int],
    projector_size_px: tuple[int, int],
    *,
    radial_terms: int,
    tangential: bool,
) -> Adjustment:
    """Fit all unknowns by weighted least squares, each device weighted by its own residuals.

    The projector position of a corner is read at the corner's position in the camera's picture, so
    an error of that position is in both residuals. It is subtracted from the projector's residual.
    The rest is the error of the code, which is often far smaller, so that the projector's residuals
    determine the pose between the devices precisely.

    The start is Zhang's calibration of each device alone (OpenCV). Corners beyond six times the
    median residual are left out once, and the rest is fitted again. Then, while the last radial
    term of a device is less than 5 standard deviations from 0, it is set to 0 and the rest is
    fitted again, because a term fitted to noise distorts regions without corners.

    Source: Z. Zhang, "A flexible new technique for camera calibration", TPAMI 2000; B. Triggs et
    al., "Bundle adjustment - a modern synthesis", 2000.
    """
    stand = np.zeros(int(obs.view.max()) + 1, dtype=np.intp)
    free = _free(radial_terms, tangential, poses=1 + len(stand))
    start = np.where(free, _start(obs, camera_size_px, projector_size_px, stand), 0.0)
    inlier, good, (fitted, jacobian, sigma_px) = _robust_fit(start, free, obs, stand)
    undetermined: dict[str, tuple[float, float]] = {}
    while loose := _loose_terms(fitted, free, jacobian):
        undetermined |= {name: (value, sigma) for name, (_, value, sigma) in loose.items()}
        free = free.copy()
        free[[place for place, *_ in loose.values()]] = False
        fitted, jacobian, sigma_px = _fit(np.where(free, fitted, 0.0), free, good, stand)
    residual = _residuals(fitted, obs, stand)
    camera, projector, (T_proj_cam,), T_cam_board = _unpack(fitted, stand)
    return Adjustment(
        camera=_optics(camera, camera_size_px),
        projector=_optics(projector, projector_size_px),
        T_cam_proj=inverse(T_proj_cam),
        T_cam_board=T_cam_board,
        camera_residual_px=residual[:, 0],
        projector_residual_px=residual[:, 1],
        residual_px=_independent(residual, obs),
        inlier=inlier,
        sigma_px=sigma_px,
        deviation=_deviations(fitted, free, jacobian),
        undetermined=undetermined,
    )


def adjust_stands(
    obs: Observations,
    stand: Int[np.ndarray, " views"],
    camera_size_px: tuple[int, int],
    projector_size_px: tuple[int, int],
    *,
    radial_terms: int,
    tangential: bool,
) -> Stands:
    """Fit like `adjust`, but with a separate pose between the devices for each group of views.

    Args:
        stand: the group of each view, counted from 0.

    Raises:
        CalibrationError: the fit does not converge.
    """
    stands = int(stand.max()) + 1
    free = _free(radial_terms, tangential, poses=stands + len(stand))
    start = np.where(free, _start(obs, camera_size_px, projector_size_px, stand), 0.0)
    inlier, good, (fitted, jacobian, sigma_px) = _robust_fit(start, free, obs, stand)
    return Stands(
        T_cam_proj=np.array([inverse(T) for T in _unpack(fitted, stand)[2]]),
        number=fitted[18 : 18 + 6 * stands].reshape(-1, 6),
        information=_information(jacobian[:, -6 * (stands + len(stand)) :], good.view, stand),
        residual_px=_independent(_residuals(fitted, obs, stand), obs),
        inlier=inlier,
        sigma_px=sigma_px,
    )


def _information(jacobian, view, stand) -> Float[np.ndarray, "stands 6 6"]:
    """Return each stand's information matrix after elimination of the board poses."""
    stands = int(stand.max()) + 1
    total = np.zeros((stands, 6, 6))
    rows = jacobian.reshape(len(view), 4, -1)
    for k, own in enumerate(stand):
        some = rows[view == k].reshape(-1, rows.shape[-1])
        pose = some[:, 6 * own : 6 * own + 6]
        board = some[:, 6 * (stands + k) : 6 * (stands + k) + 6]
        own_part = pose - board @ np.linalg.lstsq(board, pose, rcond=None)[0]
        total[own] += own_part.T @ own_part
    return total


def _robust_fit(start, free, obs: Observations, stand):
    """Fit all corners, then only the inliers; return their mask, the inliers and the second fit."""
    fitted, *_ = _fit(start, free, obs, stand)
    size = np.linalg.norm(_independent(_residuals(fitted, obs, stand), obs), axis=2)
    inlier = (size <= OUTLIER * np.maximum(np.median(size, axis=0), OUTLIER_FLOOR_PX)).all(axis=1)
    # A view with too few inliers has no pose, so all corners are fitted until a caller removes it.
    whole = np.bincount(obs.view, weights=inlier).min() >= LEAST_OF_VIEW
    good = obs.only(inlier) if whole else obs
    return inlier, good, _fit(fitted, free, good, stand)


def _loose_terms(fitted, free, jacobian) -> dict[str, tuple[int, float, float]]:
    """Return each device's last radial term if it is not significant: index, value, deviation."""
    deviation = _deviations(fitted, free, jacobian)
    loose = {}
    for first, device in ((0, "camera"), (len(DEVICE), "projector")):
        places = [first + DEVICE.index(term) for term in RADIAL]
        last = max((place for place in places if free[place]), default=None, key=places.index)
        if last is None:
            continue
        name = f"{device}.{DEVICE[last - first]}"
        value, sigma = float(fitted[last]), deviation[name]
        if abs(value) < DETERMINED * sigma:
            loose[name] = last, value, sigma
    return loose


# Order of the unknowns: camera (9), projector (9), T_proj_cam (6) of each stand, T_cam_board (6) of
# each view. `stand[k]` is the stand of view k; views of one stand share one T_proj_cam.


def _unpack(unknown, stand):
    poses, stands = unknown[18:].reshape(-1, 6), int(stand.max()) + 1
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(poses[:, :3]).as_matrix()
    T[:, :3, 3] = poses[:, 3:]
    return unknown[:9], unknown[9:18], T[:stands], T[stands:]


def _free(radial_terms: int, tangential: bool, *, poses: int) -> Bool[np.ndarray, " unknowns"]:
    radial = [radial_terms > i for i in range(3)]
    device = [True] * 4 + [radial[0], radial[1], tangential, tangential, radial[2]]
    return np.array(device + device + [True] * 6 * poses)


def _residuals(unknown, obs: Observations, stand) -> Float[np.ndarray, "n 2 2"]:
    """Return measured minus predicted (x, y) [px] of all corners in camera and projector."""
    camera, projector, T_proj_cam, T_cam_board = _unpack(unknown, stand)
    T, between = T_cam_board[obs.view], T_proj_cam[stand[obs.view]]
    in_cam = np.einsum("nij,nj->ni", T[:, :3, :3], obs.point_m) + T[:, :3, 3]
    in_proj = np.einsum("nij,nj->ni", between[:, :3, :3], in_cam) + between[:, :3, 3]
    return np.stack(
        [obs.camera_px - _image(camera, in_cam), obs.projector_px - _image(projector, in_proj)],
        axis=1,
    )


def _independent(residual, obs: Observations) -> Float[np.ndarray, "n 2 2"]:
    """Return the residuals after subtracting the camera's share from the projector's residuals."""
    carried = np.einsum("nij,nj->ni", obs.per_camera_px, residual[:, 0])
    return np.stack([residual[:, 0], residual[:, 1] - carried], axis=1)


def _image(device, point_m):
    """Project points; unlike `optics.project`, accept rays at which the distortion folds back."""
    ideal = point_m[:, :2] / point_m[:, 2:]
    return distort(ideal, tuple(device[4:])) * device[:2] + device[2:4]


def _fit(start, free, obs: Observations, stand):
    """Return the fitted unknowns, the Jacobian of residuals divided by sigma, and sigma [px]."""
    sigma_px, unknown = np.ones(2), start

    def errors(free_values):
        trial = unknown.copy()
        trial[free] = free_values
        return _independent(_residuals(trial, obs, stand), obs) / sigma_px[:, None]

    for _ in range(REWEIGHTINGS):
        try:
            outcome = least_squares(
                lambda values: errors(values).ravel(),
                unknown[free],
                jac=lambda values: _jacobian(errors, values, obs.view, stand),
                method="lm",
                x_scale="jac",
                max_nfev=MOST_STEPS,
            )
        except (ValueError, np.linalg.LinAlgError) as error:  # Values may be infinite or NaN.
            raise CalibrationError(NO_FIT) from error
        unknown = unknown.copy()
        unknown[free] = outcome.x
        sigma_before = sigma_px
        squares = np.square(errors(outcome.x) * sigma_px[:, None]).mean(axis=(0, 2))
        lost = 1 - free.sum() / (4 * len(obs.view))  # Fitted unknowns absorb part of the scatter.
        sigma_px = np.maximum(np.sqrt(squares / lost), 1e-6)
        if np.abs(sigma_px / sigma_before - 1).max() < 0.02:
            break
    jacobian = _jacobian(errors, outcome.x, obs.view, stand)
    if not (outcome.success and np.isfinite(jacobian).all()):
        raise CalibrationError(NO_FIT)
    return unknown, jacobian, sigma_px


def _jacobian(errors, values, view, stand) -> Float[np.ndarray, "rows unknowns"]:
    """Return central differences; poses of one kind vary at once, as each affects other views."""
    step = 1e-6 * np.maximum(np.abs(values), 1e-2)
    views, stands = len(stand), int(stand.max()) + 1
    shared = len(values) - 6 * (stands + views)
    jacobian = np.zeros((len(view), 4, len(values)))

    def difference(which):
        moved = np.zeros_like(values)
        moved[which] = step[which]
        return (errors(values + moved) - errors(values - moved)).reshape(-1, 4)

    for i in range(shared):
        jacobian[:, :, i] = difference(i) / (2 * step[i])
    for first, count, pose in ((shared, stands, stand[view]), (shared + 6 * stands, views, view)):
        for axis in range(6):
            own = first + 6 * pose + axis
            change = difference(first + 6 * np.arange(count) + axis)
            jacobian[np.arange(len(view)), :, own] = change / (2 * step[own, None])
    return jacobian.reshape(-1, len(values))


def _deviations(unknown, free, jacobian) -> dict[str, float]:
    """Return standard deviations of the devices' numbers, from the inverse normal matrix."""
    scale = np.linalg.norm(jacobian, axis=0)  # Units of the unknowns differ by orders of magnitude.
    unit = jacobian / scale
    covariance = np.linalg.pinv(unit.T @ unit) / np.outer(scale, scale)
    names = [f"camera.{name}" for name in DEVICE] + [f"projector.{name}" for name in DEVICE]
    names += [f"T_proj_cam.{name}" for name in POSE]
    fitted = [name for name, is_free in zip(names, free[: len(names)], strict=True) if is_free]
    deviation = dict(zip(fitted, np.sqrt(np.diag(covariance)).tolist(), strict=False))
    at = [fitted.index(f"T_proj_cam.{axis}") for axis in ("x_m", "y_m", "z_m")]
    direction = unknown[21:24] / np.linalg.norm(unknown[21:24])
    deviation["baseline_m"] = float(np.sqrt(direction @ covariance[np.ix_(at, at)] @ direction))
    return deviation


def _optics(device, size_px: tuple[int, int]) -> Optics:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(number) for number in device)
    return Optics(
        width_px=size_px[0],
        height_px=size_px[1],
        fx_px=fx,
        fy_px=fy,
        cx_px=cx,
        cy_px=cy,
        distortion=(k1, k2, p1, p2, k3),
    )


def poses_between(
    obs: Observations, camera_size_px: tuple[int, int], projector_size_px: tuple[int, int]
) -> Float[np.ndarray, "views 4 4"]:
    """Return `T_proj_cam` of each view when each device is calibrated alone."""
    T_cam_board = _alone(obs, obs.camera_px, camera_size_px)[1]
    return _alone(obs, obs.projector_px, projector_size_px)[1] @ inverse(T_cam_board)


def rms_alone_px(
    obs: Observations, position_px: Float[np.ndarray, "n 2"], size_px: tuple[int, int]
) -> float:
    """Return the RMS residual [px] of one device's corners when the device is calibrated alone."""
    return _alone(obs, position_px, size_px)[2]


def _start(
    obs: Observations, camera_size_px, projector_size_px, stand
) -> Float[np.ndarray, " unknowns"]:
    camera, T_cam_board, _ = _alone(obs, obs.camera_px, camera_size_px)
    projector, T_proj_board, _ = _alone(obs, obs.projector_px, projector_size_px)
    T_proj_cam = T_proj_board @ inverse(T_cam_board)
    between = [_middle(T_proj_cam[stand == k]) for k in range(int(stand.max()) + 1)]
    poses = np.concatenate([between, T_cam_board])
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    return np.concatenate([camera, projector, np.hstack([turns, poses[:, :3, 3]]).ravel()])


def _middle(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "4 4"]:
    rotation = Rotation.from_matrix(T[:, :3, :3]).mean()
    return rigid(rotation.as_matrix(), np.median(T[:, :3, 3], axis=0))


def _alone(obs: Observations, position_px, size_px):
    """Calibrate one device with two radial terms (OpenCV); return it, board poses and RMS [px]."""
    views = range(int(obs.view.max()) + 1)
    point = [obs.point_m[obs.view == v].astype(np.float32) for v in views]
    position = [position_px[obs.view == v].astype(np.float32) for v in views]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    try:
        rms_px, K, terms, turns, shifts = cv2.calibrateCamera(
            point, position, size_px, None, None, flags=flags
        )
    except cv2.error as error:
        raise CalibrationError(NO_FIT) from error
    device = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], terms.ravel()[:5]])
    poses = [
        rigid(cv2.Rodrigues(turn)[0], shift.ravel())
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    return device, np.array(poses), float(rms_px)
