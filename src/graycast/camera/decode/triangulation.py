"""From projector positions to depth, where camera rays meet projector planes."""

import numpy as np
from jaxtyping import Bool, Float

from ...base.frames import transform_points
from ...rig.optics import picture_rays, project, rays, undistort
from ...rig.pair import Rig
from ...rig.pattern import Axis
from .field import beside_projector
from .maps import CodeMap, DepthMap, Reason

DISTORTION_ITERATIONS = 5
EPIPOLAR_SIGMAS = 3.0


def triangulation_axis(rig: Rig) -> Axis:
    """The projector axis parallel to the baseline; only the code of this axis gives depth."""
    camera_in_proj = rig.T_proj_cam[:3, 3]
    return "column" if abs(camera_in_proj[0]) >= abs(camera_in_proj[1]) else "row"


def triangulate(codes: CodeMap, rig: Rig, *, max_epipolar_px: float = 0.0) -> DepthMap:
    """Depth where each camera ray meets its projector plane.

    The three linear equations of design: two say that the point is on the pixel's ray,
    `X = x Z`, `Y = y Z`; with them the third, the projector's `(P1 - u P3) (X, Y, Z, 1) = 0`, has
    the one unknown Z (docs/explanation/depth.md, "Triangulation"). Distortion is taken off
    first: the camera's from its rays, the projector's from (u, v), v decoded or else iterated.
    The standard deviation is that of the code, carried through dZ/du; the rig is taken as exact.
    Pixels without a code that the projector cannot light within the working range have the reason
    OUTSIDE_PROJECTOR.

    Args:
        max_epipolar_px: where both axes are coded, a point whose other coordinate lies farther
            from the epipolar line than this and three of its standard deviations is an outlier.

    Raises:
        ValueError: the code lacks the axis along the baseline, or the sizes do not fit.

    Source: K. Bai et al. 2024, equation of its section III, with u_p in the third row.
    """
    camera = rig.camera
    if codes.column.shape != (camera.height_px, camera.width_px):
        h, w = codes.column.shape
        raise ValueError(
            f"the code map is {w} x {h} px, the rig's camera {camera.width_px} x {camera.height_px}"
        )
    axis = triangulation_axis(rig)
    across, along, sigma_px, _ = _by_axis(codes, axis)
    decoded = codes.reason == Reason.DECODED
    if decoded.any() and np.isnan(across[decoded]).all():
        raise ValueError(f"the baseline needs the {axis} code; the stack has none")
    ray = picture_rays(camera)[decoded]
    depth_m, slope_m = (np.full(decoded.shape, np.nan) for _ in range(2))
    depth_m[decoded], slope_m[decoded] = _meet(ray, across[decoded], along[decoded], rig, axis)
    reason = codes.reason.copy()
    in_range = (depth_m >= rig.near_m) & (depth_m <= rig.far_m)
    reason[decoded & ~in_range] = Reason.OUT_OF_RANGE
    if max_epipolar_px and not np.isnan(along).all():
        off_px = np.full(decoded.shape, np.nan)
        point = ray * depth_m[decoded][:, None]
        off_px[decoded] = _off_the_line_px(point, along[decoded], rig, axis)
        far = off_the_line(codes, off_px, rig, limit_px=max_epipolar_px)
        reason[(reason == Reason.DECODED) & far] = Reason.OUTLIER
    reason[~decoded & beside_projector(rig)] = Reason.OUTSIDE_PROJECTOR
    known = reason == Reason.DECODED
    return DepthMap(
        depth_m=np.where(known, depth_m, np.nan).astype(np.float32),
        sigma_m=np.where(known, np.abs(slope_m) * sigma_px, np.nan).astype(np.float32),
        reason=reason,
        camera=camera,
    )


def meet_planes(
    pixel: Float[np.ndarray, "n 2"],
    column: Float[np.ndarray, " n"],
    row: Float[np.ndarray, " n"],
    rig: Rig,
) -> Float[np.ndarray, "n 3"]:
    """Where the rays of camera pixels (x, y) meet their projector planes, in the camera frame [m].

    The equations are those of `triangulate`. NaN where ray and plane do not meet before the camera.

    Args:
        column: projector column of each pixel; NaN throughout if it is not coded.
        row: likewise the row. One of the two, that along the baseline, is needed.
    """
    axis = triangulation_axis(rig)
    across, along = (column, row) if axis == "column" else (row, column)
    ray = rays(rig.camera, pixel)
    depth_m = _meet(ray, across, along, rig, axis)[0]
    return ray * np.where(depth_m > 0, depth_m, np.nan)[:, None]


def epipolar_residual_px(codes: CodeMap, depth: DepthMap, rig: Rig) -> Float[np.ndarray, "h w"]:
    """How far the other coordinate lies from where the depth puts it [px]; NaN where unknown.

    It measures calibration and decoding together, by what depth did not use.
    """
    camera = rig.camera
    axis = triangulation_axis(rig)
    along = _by_axis(codes, axis)[1]
    known = np.isfinite(depth.depth_m) & np.isfinite(along)
    ray = picture_rays(camera)[known]
    off_px = np.full(known.shape, np.nan)
    point = ray * depth.depth_m[known][:, None]
    off_px[known] = _off_the_line_px(point, along[known], rig, axis)
    return off_px


def off_the_line(
    codes: CodeMap, residual_px: Float[np.ndarray, "h w"], rig: Rig, *, limit_px: float
) -> Bool[np.ndarray, "h w"]:
    """Which points lie farther off their epipolar line than a limit and their own noise.

    The noise is that of the coordinate that depth does not use: the line is taken as exact.
    """
    sigma_along_px = _by_axis(codes, triangulation_axis(rig))[3]
    return np.abs(residual_px) > limit_px + EPIPOLAR_SIGMAS * sigma_along_px


def _by_axis(codes: CodeMap, axis: Axis) -> tuple:
    """Position across the planes of depth and along them, then their standard deviations."""
    column, row = (codes.column, codes.sigma_column), (codes.row, codes.sigma_row)
    across, along = (column, row) if axis == "column" else (row, column)
    return across[0], along[0], across[1], along[1]


def _off_the_line_px(point, along, rig: Rig, axis: Axis) -> Float[np.ndarray, "*n"]:
    expected = project(rig.projector, transform_points(rig.T_proj_cam, point))
    return along - expected[..., 1 if axis == "column" else 0]


def _meet(
    ray, across, along, rig: Rig, axis: Axis
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Depth [m], and how it changes with the position across [m/px]."""
    projector = rig.projector
    T_proj_cam = rig.T_proj_cam
    i = 0 if axis == "column" else 1
    focal = (projector.fx_px, projector.fy_px)
    centre = (projector.cx_px, projector.cy_px)
    ideal = (across.astype(np.float64) - centre[i]) / focal[i]
    if not projector.has_distortion:
        return _depth(ray, ideal, T_proj_cam, i, focal[i])
    # The distorted coordinate along the plane: as decoded, else from the last depth.
    distorted = ideal
    other = (along.astype(np.float64) - centre[1 - i]) / focal[1 - i]
    decoded = np.isfinite(other)
    depth_m, slope_m = _depth(ray, ideal, T_proj_cam, i, focal[i])
    for _ in range(1 if decoded.all() else DISTORTION_ITERATIONS):
        point = transform_points(T_proj_cam, ray * depth_m[..., None])
        guess = project(projector, point)[..., 1 - i]
        # What is lit lies in the picture; beyond it, where wrong codes lead, a lens may fold over.
        guess = np.clip(guess, -0.5, (projector.width_px, projector.height_px)[1 - i] - 0.5)
        guess = (guess - centre[1 - i]) / focal[1 - i]
        along_now = np.where(decoded, other, guess)
        pair = (distorted, along_now) if i == 0 else (along_now, distorted)
        xy = np.stack(pair, axis=-1)
        known = np.isfinite(xy).all(axis=-1)
        ideal = np.full(distorted.shape, np.nan)
        ideal[known] = undistort(xy[known], projector.distortion)[:, i]
        depth_m, slope_m = _depth(ray, ideal, T_proj_cam, i, focal[i])
    return depth_m, slope_m


def _depth(ray, ideal, T_proj_cam, i: int, focal_px: float):
    """Z of `(R_i - ideal R_3) ray Z + (t_i - ideal t_3) = 0`, and dZ/du; no Z is NaN or not > 0.

    The slope leaves out how distortion scales (u, v) locally, a few per cent.
    """
    rotation, translation = T_proj_cam[:3, :3], T_proj_cam[:3, 3]
    ahead = ray @ rotation[2]
    facing = ray @ rotation[i] - ideal * ahead
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = (ideal * translation[2] - translation[i]) / facing
        slope_m = (translation[2] + depth_m * ahead) / facing / focal_px
    return depth_m, slope_m
