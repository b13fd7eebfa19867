"""A rig from views of a board, with its residuals and its coverage."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from ...frames import inverse
from ...optics import Optics, rays
from ...rig import Rig
from .adjust import Adjustment, Observations, adjust, joined
from .board import Board, CalibrationError
from .corners import MIN_CORNERS, find_corners
from .projector_corners import projector_corners

MIN_VIEWS = 3  # of a plane in different directions, below which the intrinsics are not determined
GOOD_VIEWS = 8
GOOD_SPREAD_RAD = math.radians(20)  # between the two boards that differ most in direction
GOOD_COVERAGE = 0.4  # as a share of the picture, within the hull of all corners
OUTLYING = 2.5  # times the median view's residual
OUTLYING_FLOOR_PX = 0.05  # below it a view is good, whatever the others are
GOOD_DEVIATION = 0.001  # of the focal length and the baseline
RANGE_MARGIN = 0.1  # beyond the nearest and the farthest corner, as a share of their depth


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardView:
    """One pose of the board: its picture under white light and the decoded projector pixels.

    `column` and `row` are in projector pixels, NaN where unknown.
    """

    name: str
    white: Shaped[np.ndarray, "h w"]
    column: Float[np.ndarray, "h w"]
    row: Float[np.ndarray, "h w"]
    sigma_column: Float[np.ndarray, "h w"] | None = None
    sigma_row: Float[np.ndarray, "h w"] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewResidual:
    """How well one view fits. RMS is of the distance in the picture, as OpenCV counts it.

    `epipolar_rms_px` is the distance of a projector corner from the line on which the camera's
    corner puts it. `left_out` corners disagreed so strongly that the fit does without them; they
    are not in the residuals. `undecoded` ones had no code around them.
    """

    name: str
    corners: int
    left_out: int
    undecoded: int
    camera_rms_px: float
    projector_rms_px: float
    epipolar_rms_px: float
    tilt_rad: float  # of the board against the camera's axis
    T_cam_board: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """The rig, its residuals over all views, and the standard deviation of each fitted number.

    `coverage` is the share of the camera's and of the projector's picture within the hull of all
    corners: outside it the distortion is a guess. `undetermined` has the radial terms that are 0
    because the corners do not tell them from it, with what was fitted and its standard deviation.
    `warnings` are for the user to read.
    """

    rig: Rig
    views: tuple[ViewResidual, ...]
    camera_rms_px: float
    projector_rms_px: float
    epipolar_rms_px: float
    deviation: dict[str, float]
    undetermined: dict[str, tuple[float, float]]
    coverage: tuple[float, float]
    warnings: tuple[str, ...]


def calibrate_rig(
    views: Sequence[BoardView],
    board: Board,
    *,
    projector_size_px: tuple[int, int],
    name: str = "calibrated",
    near_m: float | None = None,
    far_m: float | None = None,
    radial_terms: int = 3,
    tangential: bool = True,
) -> Calibration:
    """Camera, projector and the pose between them from a board in three or more directions.

    The projector is an inverse camera: the decoded code says where it "sees" each corner.

    Args:
        projector_size_px: (width, height).
        near_m: nearest depth of the working range; None takes the nearest corner less 10 %.
        far_m: likewise farthest.
        radial_terms: how many of k1, k2, k3 are fitted at most, 0 to 3; the rest are 0, and so are
            last terms that the corners do not determine.
        tangential: whether p1 and p2 are fitted.

    Raises:
        CalibrationError: too few views, no board in one, too few decoded corners, or a distortion
            that folds over inside the picture; the text names the views and the remedy.

    Leaves out: skew; a board that is bent; defocus, whose blur is taken to leave edges in place.
    """
    if radial_terms not in range(4):
        raise ValueError(f"radial_terms is {radial_terms}; give 0 to 3")
    camera_size_px = _check(views)
    seen, undecoded = _observe(views, board, projector_size_px)
    fit = adjust(
        seen,
        camera_size_px,
        projector_size_px,
        radial_terms=radial_terms,
        tangential=tangential,
    )
    _check_fold("camera", fit.camera)
    _check_fold("projector", fit.projector)
    epipolar_px = epipolar_distance_px(
        fit.camera, fit.projector, fit.T_cam_proj, seen.camera_px, seen.projector_px
    )
    each = tuple(
        _view_residual(index, view.name, seen, fit, epipolar_px, undecoded[index])
        for index, view in enumerate(views)
    )
    T = fit.T_cam_board[seen.view]
    depth_m = (np.einsum("nj,nj->n", T[:, 2, :3], seen.point_m) + T[:, 2, 3])[fit.kept]
    rig = Rig(
        name=name,
        camera=fit.camera,
        projector=fit.projector,
        T_cam_proj=fit.T_cam_proj,
        near_m=float(depth_m.min() * (1 - RANGE_MARGIN)) if near_m is None else near_m,
        far_m=float(depth_m.max() * (1 + RANGE_MARGIN)) if far_m is None else far_m,
    )
    coverage = (
        _coverage(seen.camera_px[fit.kept], camera_size_px),
        _coverage(seen.projector_px[fit.kept], projector_size_px),
    )
    return Calibration(
        rig=rig,
        views=each,
        camera_rms_px=_rms(fit.camera_residual_px[fit.kept]),
        projector_rms_px=_rms(fit.projector_residual_px[fit.kept]),
        epipolar_rms_px=_rms(epipolar_px[fit.kept, None]),
        deviation=fit.deviation,
        undetermined=fit.undetermined,
        coverage=coverage,
        warnings=tuple(_warnings(rig, each, fit, coverage)),
    )


def epipolar_distance_px(
    camera: Optics,
    projector: Optics,
    T_cam_proj: Float[np.ndarray, "4 4"],
    camera_px: Float[np.ndarray, "n 2"],
    projector_px: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " n"]:
    """Signed distance of projector points from their camera points' epipolar lines [px].

    Both are undistorted first; the distance is scaled by the mean focal length of the projector.
    """
    T_proj_cam = inverse(T_cam_proj)
    normal = np.cross(T_proj_cam[:3, 3], rays(camera, camera_px) @ T_proj_cam[:3, :3].T)
    normal = normal / np.linalg.norm(normal[:, :2], axis=1, keepdims=True)
    focal_px = math.sqrt(projector.fx_px * projector.fy_px)
    return focal_px * np.einsum("ni,ni->n", normal, rays(projector, projector_px))


def _check(views: Sequence[BoardView]) -> tuple[int, int]:
    """The camera's (width, height), after seeing that there are enough views of one size."""
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"{len(views)} views of the board; at least {MIN_VIEWS} in different directions are "
            f"needed, {GOOD_VIEWS} or more are good"
        )
    names = [view.name for view in views]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise CalibrationError(f"two views are named {', '.join(twice)}: rename one of them")
    size = views[0].white.shape
    for view in views:
        for part in (view.white, view.column, view.row):
            if part.shape != size:
                raise CalibrationError(
                    f"view {view.name} is {part.shape[1]} x {part.shape[0]} px, view "
                    f"{views[0].name} {size[1]} x {size[0]}: give pictures of one camera with one "
                    "size"
                )
    return size[1], size[0]


def _observe(
    views: Sequence[BoardView], board: Board, projector_size_px: tuple[int, int]
) -> tuple[Observations, list[int]]:
    """Every corner that both devices see, and the count of undecoded ones in each view."""
    parts, undecoded, faults = [], [], []
    for index, view in enumerate(views):
        try:
            part, missing = _observe_one(index, view, board, projector_size_px)
        except CalibrationError as error:  # tell of every bad view at once
            faults.append(f"view {view.name}: {error}")
        else:
            parts.append(part)
            undecoded.append(missing)
    if faults:
        raise CalibrationError("; ".join(faults))
    return joined(parts), undecoded


def _observe_one(index: int, view: BoardView, board: Board, projector_size_px: tuple[int, int]):
    corners = find_corners(view.white, board)
    lit = projector_corners(
        corners,
        view.column,
        view.row,
        sigma_column=view.sigma_column,
        sigma_row=view.sigma_row,
    )
    decoded = np.isfinite(lit.position_px).all(axis=1)
    if decoded.sum() < MIN_CORNERS:
        raise CalibrationError(
            f"{decoded.sum()} of {len(decoded)} corners have decoded columns and rows around "
            f"them, {MIN_CORNERS} are needed: light the board with the projector, and code both "
            "axes"
        )
    position_px = lit.position_px[decoded]
    # A corner may lie a little outside, where the fit reads beyond the last lit pixel.
    if position_px.min() < -2 or (position_px > np.array(projector_size_px) + 1).any():
        span = f"({position_px[:, 0].max():.0f}, {position_px[:, 1].max():.0f})"
        size = f"{projector_size_px[0]} x {projector_size_px[1]}"
        raise CalibrationError(
            f"code reaches {span}, the projector has {size} px: give the right projector size"
        )
    part = Observations(
        view=np.full(decoded.sum(), index),
        point_m=board.corners_m[corners.id[decoded]],
        camera_px=corners.position_px[decoded],
        projector_px=position_px,
        per_camera_px=lit.per_camera_px[decoded],
    )
    return part, int((~decoded).sum())


def _check_fold(device: str, optics: Optics) -> None:
    """Refuse a fit that could not be used: rays must exist over the whole picture."""
    x, y = (
        np.linspace(-0.5, optics.width_px - 0.5, 33),
        np.linspace(-0.5, optics.height_px - 0.5, 33),
    )
    try:
        rays(optics, np.stack(np.meshgrid(x, y), axis=-1))
    except ValueError:
        raise CalibrationError(
            f"the {device}'s fitted distortion {tuple(round(k, 4) for k in optics.distortion)} "
            "folds over inside its picture: show the board near the corners of the picture, or fit "
            "fewer radial terms"
        ) from None


def _view_residual(
    index: int, name: str, seen: Observations, fit: Adjustment, epipolar_px, undecoded: int
) -> ViewResidual:
    mine = seen.view == index
    used = mine & fit.kept
    normal = fit.T_cam_board[index][:3, 2]
    return ViewResidual(
        name=name,
        corners=int(used.sum()),
        left_out=int((mine & ~fit.kept).sum()),
        undecoded=undecoded,
        camera_rms_px=_rms(fit.camera_residual_px[used]),
        projector_rms_px=_rms(fit.projector_residual_px[used]),
        epipolar_rms_px=_rms(epipolar_px[used, None]),
        tilt_rad=float(np.arccos(np.clip(abs(normal[2]), 0, 1))),
        T_cam_board=fit.T_cam_board[index],
    )


def _rms(residual: Float[np.ndarray, "n d"]) -> float:
    """Root mean square length; NaN of nothing."""
    return float(np.sqrt(np.square(residual).sum(axis=1).mean())) if len(residual) else math.nan


def _coverage(position_px: Float[np.ndarray, "n 2"], size_px: tuple[int, int]) -> float:
    hull = cv2.convexHull(position_px.astype(np.float32))
    return float(cv2.contourArea(hull)) / (size_px[0] * size_px[1])


def _warnings(rig: Rig, views: Sequence[ViewResidual], fit: Adjustment, coverage):
    """Warnings about the reliability of the rig."""
    if len(views) < GOOD_VIEWS:
        yield f"only {len(views)} views: {GOOD_VIEWS} or more make the result steady"
    normal = fit.T_cam_board[:, :3, 2]
    spread = float(np.arccos(np.clip(np.abs(normal @ normal.T), 0, 1)).max())
    if spread < GOOD_SPREAD_RAD:
        yield (
            f"the boards are within {math.degrees(spread):.1f} degrees of parallel: the focal "
            "lengths are poorly determined; tilt the board by 20 to 45 degrees in several "
            "directions"
        )
    for device, share in zip(("camera", "projector"), coverage, strict=True):
        if share < GOOD_COVERAGE:
            yield (
                f"the corners cover {100 * share:.0f} % of the {device}'s picture: the distortion "
                "elsewhere is extrapolated; show the board also near the borders"
            )
    yield from _outlying(views)
    yield from _loose(rig, fit.deviation)


def _outlying(views: Sequence[ViewResidual]):
    for device in ("camera", "projector"):
        rms = np.array([getattr(view, f"{device}_rms_px") for view in views])
        for view, value in zip(views, rms, strict=True):
            if not value <= max(OUTLYING * np.median(rms), OUTLYING_FLOOR_PX):
                yield (
                    f"view {view.name} fits badly: {device} residual {value:.3f} px, the median "
                    f"view has {np.median(rms):.3f}; the board may have moved during its stack"
                )
    for view in views:
        lost = view.left_out + view.undecoded
        if lost > 0.2 * (view.corners + lost):
            yield (
                f"view {view.name} gives {view.corners} corners: {view.left_out} disagree and "
                f"{view.undecoded} are not decoded"
            )


def _loose(rig: Rig, deviation: dict[str, float]):
    for device, optics in (("camera", rig.camera), ("projector", rig.projector)):
        share = deviation[f"{device}.fx_px"] / optics.fx_px
        if not share < GOOD_DEVIATION:
            yield (
                f"the {device}'s focal length is uncertain by {100 * share:.2f} %: add views, "
                "especially tilted ones"
            )
    share = deviation["baseline_m"] / rig.baseline_m
    if not share < GOOD_DEVIATION:
        yield f"the baseline is uncertain by {100 * share:.2f} %: add views"
