"""Calibration of a rig from views of a board, with residuals, uncertainty and warnings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from ...base.frames import inverse
from ...rig.optics import Optics, distort, rays
from ...rig.pair import Rig
from .adjust import NO_FIT, Adjustment, Observations
from .agreement import fit_agreeing, outlying
from .board import Board, CalibrationError
from .observing import GOOD_VIEWS, MOST_RMS, BoardView, Observed, check_views, grouped, observe

GOOD_SPREAD_RAD = math.radians(20)  # At least two boards should differ in direction by this angle.
GOOD_COVERAGE = 0.4  # The convex hull of all corners should cover this share of the picture.
# Plausible results stay within these bounds: fx / fy or its inverse; principal point and focal
# length in picture widths; distortion as a share of the distance from the picture's centre; and a
# standard deviation as a share of its value.
MOST_ASPECT, MOST_SHIFT, MOST_DISTORTION, MOST_DEVIATION = 3.0, 2.0, 0.7, 0.3
FOCAL = (0.2, 50.0)
GOOD_DEVIATION = 0.001  # good relative standard deviation of focal length and baseline
RANGE_MARGIN = 0.1  # The range extends beyond the nearest and farthest corner by this share.


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewResidual:
    """Residuals of one view after the fit.

    `epipolar_rms_px` is the RMS distance of the projector's corners from the epipolar lines of the
    camera's corners. `left_out` counts the outliers, which are not in the fit or the residuals.
    `undecoded` counts the corners around which too few pixels are decoded.
    """

    name: str
    corners: int
    left_out: int
    undecoded: int
    camera_rms_px: float
    projector_rms_px: float
    epipolar_rms_px: float
    tilt_rad: float  # angle between the board's normal and the camera's axis
    T_cam_board: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """The rig, its residuals over all views, and the standard deviation of each fitted number.

    `coverage` is the share of the camera's and of the projector's picture within the convex hull of
    all corners; outside it, distortion is extrapolated. `undetermined` has the radial terms that
    were set to 0 because they do not differ significantly from 0, each with its fitted value and
    standard deviation. `warnings` are for the user to read.
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
    """Calibrate camera, projector and the pose between them from three or more board poses.

    The projector is an inverse camera: the decoded code says at which of its pixels it "sees" each
    corner. A view is left out, and named in a warning, if it has no board, too few decoded corners,
    a mirrored code or the pose of another view, or if it spoils the fit of the other views.

    Args:
        projector_size_px: (width, height).
        near_m: nearest depth of the working range; None takes the nearest corner less 10 %.
        far_m: farthest depth of the working range; None takes the farthest corner plus 10 %.
        radial_terms: largest number (0 to 3) of the terms k1, k2, k3 to fit; other terms are 0,
            and so are the last terms if they are not significant.
        tangential: whether p1 and p2 are fitted.

    Raises:
        CalibrationError: too few views remain, or no device can have the result; the text names
            the views and the remedy.

    Leaves out: skew, bent boards, and defocus, whose blur is assumed not to move edges.
    """
    if radial_terms not in range(4):
        raise ValueError(f"radial_terms is {radial_terms}; give 0 to 3")
    camera_size_px = check_views(views)
    observed = observe(
        views, board, camera_size_px=camera_size_px, projector_size_px=projector_size_px
    )
    observed, fit = fit_agreeing(
        observed, (camera_size_px, projector_size_px), radial_terms, tangential
    )
    _refuse_impossible(fit)
    corners = observed.corners
    epipolar_px = epipolar_distance_px(
        fit.camera, fit.projector, fit.T_cam_proj, corners.camera_px, corners.projector_px
    )
    each = tuple(
        _view_residual(index, view.name, corners, fit, epipolar_px, view.undecoded)
        for index, view in enumerate(observed.views)
    )
    nearest_m, farthest_m = _range_m(corners, fit)
    rig = Rig(
        name=name,
        camera=fit.camera,
        projector=fit.projector,
        T_cam_proj=fit.T_cam_proj,
        near_m=nearest_m if near_m is None else near_m,
        far_m=farthest_m if far_m is None else far_m,
    )
    coverage = (
        _coverage(corners.camera_px[fit.inlier], camera_size_px),
        _coverage(corners.projector_px[fit.inlier], projector_size_px),
    )
    return Calibration(
        rig=rig,
        views=each,
        camera_rms_px=_rms(fit.camera_residual_px[fit.inlier]),
        projector_rms_px=_rms(fit.projector_residual_px[fit.inlier]),
        epipolar_rms_px=_rms(epipolar_px[fit.inlier, None]),
        deviation=fit.deviation,
        undetermined=fit.undetermined,
        coverage=coverage,
        warnings=(
            *(f"the fit leaves out {each}: {why}" for each, why in grouped(observed.left_out)),
            *_symptoms(views, observed),
            *_warnings(rig, each, fit, coverage),
            *(f"view {view}: {why}" for view, (_, why) in outlying(observed, fit).items()),
        ),
    )


def _range_m(observations: Observations, fit: Adjustment) -> tuple[float, float]:
    """Return the depths [m] of the nearest and the farthest corner, with a margin."""
    T = fit.T_cam_board[observations.view]
    depth_m = (np.einsum("nj,nj->n", T[:, 2, :3], observations.point_m) + T[:, 2, 3])[fit.inlier]
    return float(depth_m.min() * (1 - RANGE_MARGIN)), float(depth_m.max() * (1 + RANGE_MARGIN))


def epipolar_distance_px(
    camera: Optics,
    projector: Optics,
    T_cam_proj: Float[np.ndarray, "4 4"],
    camera_px: Float[np.ndarray, "n 2"],
    projector_px: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " n"]:
    """Return the signed distance [px] of projector points from the camera points' epipolar lines.

    Points are undistorted first; the distance is scaled by the projector's mean focal length.
    """
    T_proj_cam = inverse(T_cam_proj)
    normal = np.cross(T_proj_cam[:3, 3], rays(camera, camera_px) @ T_proj_cam[:3, :3].T)
    normal = normal / np.linalg.norm(normal[:, :2], axis=1, keepdims=True)
    focal_px = math.sqrt(projector.fx_px * projector.fy_px)
    return focal_px * np.einsum("ni,ni->n", normal, rays(projector, projector_px))


def _refuse_impossible(fit: Adjustment) -> None:
    """Refuse a result that no camera or projector can have or that the views do not determine."""
    for device, optics, residual_px in (
        ("camera", fit.camera, fit.camera_residual_px),
        ("projector", fit.projector, fit.projector_residual_px),
    ):
        for wrong in _impossible(optics, _rms(residual_px[fit.inlier])):
            raise CalibrationError(f"the {device} has {wrong}, which is not possible: {NO_FIT}")
        _check_fold(device, optics)
    T_m = float(np.linalg.norm(fit.T_cam_proj[:3, 3]))
    for name, value in (
        ("camera.fx_px", fit.camera.fx_px),
        ("projector.fx_px", fit.projector.fx_px),
        ("baseline_m", T_m),
    ):
        if not fit.deviation[name] < MOST_DEVIATION * value:
            raise CalibrationError(
                f"{name} is {value:.4g} +- {fit.deviation[name]:.2g}, so the views do not "
                "determine it: tilt the board by 20 to 45 degrees in several directions"
            )


def _impossible(optics: Optics, rms_px: float):
    """Yield descriptions of the fitted properties that no device can have."""
    width_px, height_px = optics.width_px, optics.height_px
    aspect = optics.fx_px / optics.fy_px
    if not 1 / MOST_ASPECT < aspect < MOST_ASPECT:
        yield f"focal lengths of {optics.fx_px:.4g} and {optics.fy_px:.4g} px"
    if not FOCAL[0] * width_px < optics.fx_px < FOCAL[1] * width_px:
        yield f"a focal length of {optics.fx_px:.4g} px for a picture {width_px} px wide"
    shift = max(abs(optics.cx_px / width_px - 0.5), abs(optics.cy_px / height_px - 0.5))
    if not shift < MOST_SHIFT:
        yield f"its principal point at ({optics.cx_px:.4g}, {optics.cy_px:.4g}) px"
    corner = np.array([width_px / optics.fx_px, height_px / optics.fy_px]) / 2
    moved = np.linalg.norm(distort(corner, optics.distortion) - corner) / np.linalg.norm(corner)
    if not moved < MOST_DISTORTION:
        yield f"the distortion {tuple(float(f'{k:.3g}') for k in optics.distortion)}"
    if not rms_px < MOST_RMS * width_px:
        yield f"a residual of {rms_px:.3g} px (RMS)"


def _check_fold(device: str, optics: Optics) -> None:
    """Refuse a fit whose distortion folds back, so that some pixels of the picture have no ray."""
    x, y = (np.linspace(-0.5, size_px - 0.5, 33) for size_px in (optics.width_px, optics.height_px))
    try:
        rays(optics, np.stack(np.meshgrid(x, y), axis=-1))
    except ValueError:
        raise CalibrationError(
            f"the {device}'s fitted distortion {tuple(round(k, 4) for k in optics.distortion)} "
            "folds over inside its picture: show the board near the corners of the picture, or fit "
            "fewer radial terms"
        ) from None


def _view_residual(
    index: int, name: str, obs: Observations, fit: Adjustment, epipolar_px, undecoded: int
) -> ViewResidual:
    mine = obs.view == index
    used = mine & fit.inlier
    normal = fit.T_cam_board[index][:3, 2]
    return ViewResidual(
        name=name,
        corners=int(used.sum()),
        left_out=int((mine & ~fit.inlier).sum()),
        undecoded=undecoded,
        camera_rms_px=_rms(fit.camera_residual_px[used]),
        projector_rms_px=_rms(fit.projector_residual_px[used]),
        epipolar_rms_px=_rms(epipolar_px[used, None]),
        tilt_rad=float(np.arccos(np.clip(abs(normal[2]), 0, 1))),
        T_cam_board=fit.T_cam_board[index],
    )


def _rms(residual: Float[np.ndarray, "n d"]) -> float:
    """Return the RMS length of vectors; NaN if there are no vectors."""
    return float(np.sqrt(np.square(residual).sum(axis=1).mean())) if len(residual) else math.nan


def _coverage(position_px: Float[np.ndarray, "n 2"], size_px: tuple[int, int]) -> float:
    hull = cv2.convexHull(position_px.astype(np.float32))
    return float(cv2.contourArea(hull)) / (size_px[0] * size_px[1])


def _symptoms(views: Sequence[BoardView], observed: Observed):
    """Yield the warnings about the stacks of the used views."""
    used = {view.name for view in observed.views}
    most = max((len(view.symptoms) for view in views), default=0)
    for k in range(most):
        own = {v.name: v.symptoms[k] for v in views if v.name in used and k < len(v.symptoms)}
        yield from (f"{each}: {symptom}" for each, symptom in grouped(own))


def _warnings(rig: Rig, views: Sequence[ViewResidual], fit: Adjustment, coverage):
    """Yield warnings about the reliability of the rig."""
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
    yield from _loose(rig, fit.deviation)
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


def describe_calibration(calibration: Calibration) -> str:
    """Return a text with the residuals of each view, the rig, and its standard deviations."""
    lines = ["view: corners, left out, undecoded; RMS camera, projector, epipolar [px]; tilt [deg]"]
    for view in calibration.views:
        lines.append(
            f"  {view.name}: {view.corners}, {view.left_out}, {view.undecoded}; "
            f"{view.camera_rms_px:.3f}, {view.projector_rms_px:.3f}, {view.epipolar_rms_px:.3f}; "
            f"{np.degrees(view.tilt_rad):.0f}"
        )
    lines.append(
        f"all: RMS camera {calibration.camera_rms_px:.3f} px, projector "
        f"{calibration.projector_rms_px:.3f} px, epipolar {calibration.epipolar_rms_px:.3f} px"
    )
    camera, projector = calibration.coverage
    lines.append(f"corners cover {camera:.0%} of the camera's picture, {projector:.0%} of the "
                 "projector's")  # fmt: skip
    rig = calibration.rig
    lines.append(f"baseline {rig.baseline_m * 1e3:.3f} mm")
    for name, optics in (("camera", rig.camera), ("projector", rig.projector)):
        distortion = ", ".join(f"{value:.5f}" for value in optics.distortion)
        lines.append(
            f"{name}: fx {optics.fx_px:.2f}, fy {optics.fy_px:.2f}, cx {optics.cx_px:.2f}, "
            f"cy {optics.cy_px:.2f} px; distortion {distortion}"
        )
    lines += ["standard deviations:"]
    lines += [f"  {name:24} {value:.3g}" for name, value in calibration.deviation.items()]
    lines += [
        f"set to 0, because the corners do not distinguish it from 0: {name} ({value:.3g} +- "
        f"{sigma:.2g})"
        for name, (value, sigma) in calibration.undetermined.items()
    ]
    return "\n".join(lines)
