"""From projector positions to depth: the intersection of camera rays and projector planes."""

import numpy as np
from jaxtyping import Bool, Float

from ...rig.optics import mask_rays, no_inverse, rays
from ...rig.pair import Rig
from ...rig.pattern import Axis
from .field import beside_projector
from .maps import CodeMap, DepthMap
from .meeting import lens_of, meet, off_the_line_px, rows_of
from .reasons import Reason

EPIPOLAR_SIGMAS = 3.0


def triangulation_axis(rig: Rig) -> Axis:
    """Return the projector axis along the baseline; only the code of this axis gives depth."""
    camera_in_proj = rig.T_proj_cam[:3, 3]
    return "column" if abs(camera_in_proj[0]) >= abs(camera_in_proj[1]) else "row"


def triangulate(codes: CodeMap, rig: Rig, *, max_epipolar_px: float = 0.0) -> DepthMap:
    """Return the depth at which each camera ray meets its projector plane.

    There are three linear equations. Two say that the point is on the pixel's ray, `X = x Z`,
    `Y = y Z`. With them the third, `(P1 - u P3) (X, Y, Z, 1) = 0` of the projector, has only the
    unknown Z (docs/explanation/depth.md, "Triangulation"). Distortion is removed first: from the
    camera's rays, and from the projector's (u, v), where v is decoded or else found by iteration.
    The standard deviation of the code is converted by dZ/du; the rig is taken as exact.
    Pixels without a code that the projector cannot light within the working range get the reason
    OUTSIDE_PROJECTOR.

    Args:
        max_epipolar_px: if both axes are coded, a point whose other coordinate is farther from the
            epipolar line than this plus three of its standard deviations is an outlier.

    Raises:
        ValueError: the axis along the baseline is not coded, or the sizes do not fit.

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
    ray = mask_rays(camera, decoded)
    depth_m, slope_m = (np.full(decoded.shape, np.nan) for _ in range(2))
    depth_m[decoded], slope_m[decoded] = _meet(ray, across[decoded], along[decoded], rig, axis)
    reason = codes.reason.copy()
    in_range = (depth_m >= rig.near_m) & (depth_m <= rig.far_m)
    reason[decoded & ~in_range] = Reason.OUT_OF_RANGE
    if max_epipolar_px and not np.isnan(along).all():
        off_px = np.full(decoded.shape, np.nan)
        off_px[decoded] = _off_the_line_px(ray, depth_m[decoded], along[decoded], rig, axis)
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
    """Return the points where rays of camera pixels (x, y) meet projector planes [m].

    Points are in the camera frame (see `triangulate`), NaN if ray and plane do not meet before it.

    Args:
        column: projector column of each pixel; all NaN if columns are not coded.
        row: the same for projector rows. The axis along the baseline must be coded.
    """
    axis = triangulation_axis(rig)
    across, along = (column, row) if axis == "column" else (row, column)
    ray = rays(rig.camera, pixel)
    depth_m = _meet(ray, across, along, rig, axis)[0]
    return ray * np.where(depth_m > 0, depth_m, np.nan)[:, None]


def epipolar_residual_px(codes: CodeMap, depth: DepthMap, rig: Rig) -> Float[np.ndarray, "h w"]:
    """Return the decoded coordinate along the planes minus its value for the measured point [px].

    The result is NaN if either is unknown. As depth does not use this coordinate, the difference
    is a check of calibration and decoding.
    """
    camera = rig.camera
    axis = triangulation_axis(rig)
    along = _by_axis(codes, axis)[1]
    known = np.isfinite(depth.depth_m) & np.isfinite(along)
    ray = mask_rays(camera, known)
    off_px = np.full(known.shape, np.nan)
    off_px[known] = _off_the_line_px(ray, depth.depth_m[known], along[known], rig, axis)
    return off_px


def off_the_line(
    codes: CodeMap, residual_px: Float[np.ndarray, "h w"], rig: Rig, *, limit_px: float
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the points that are farther from their epipolar line than limit plus noise.

    This is the noise of the coordinate that depth does not use; the line is taken as exact.
    """
    sigma_along_px = _by_axis(codes, triangulation_axis(rig))[3]
    return np.abs(residual_px) > limit_px + EPIPOLAR_SIGMAS * sigma_along_px


def _by_axis(codes: CodeMap, axis: Axis) -> tuple:
    """Return the positions across and along the planes, then their standard deviations."""
    column, row = (codes.column, codes.sigma_column), (codes.row, codes.sigma_row)
    across, along = (column, row) if axis == "column" else (row, column)
    return across[0], along[0], across[1], along[1]


def _off_the_line_px(
    ray: Float[np.ndarray, "n 3"],
    depth_m: Float[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    rig: Rig,
    axis: Axis,
) -> Float[np.ndarray, " n"]:
    """Return the positions along the planes minus the positions of measured points [px]."""
    coded = 0 if axis == "column" else 1
    off_px = np.empty(len(ray))
    T, lens = rows_of(rig.T_proj_cam, coded), lens_of(rig.projector, coded)
    off_the_line_px(ray, _doubles(depth_m), _doubles(along), T, lens, off_px)
    return off_px


def _meet(
    ray: Float[np.ndarray, "n 3"],
    across: Float[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    rig: Rig,
    axis: Axis,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return depth [m] and its derivative by the position across the planes [m/px].

    With the rows 1 to 3 of the pose R, t and the ideal position u, Z solves
    `(R_1 - u R_3) ray Z + (t_1 - u t_3) = 0`; without a solution Z is NaN or not > 0. The
    derivative leaves out the local scale of distortion, which is a few per cent.
    """
    coded = 0 if axis == "column" else 1
    depth_m, slope_m = np.empty((2, len(ray)))
    T, lens = rows_of(rig.T_proj_cam, coded), lens_of(rig.projector, coded)
    if not meet(ray, _doubles(across), _doubles(along), T, lens, depth_m, slope_m):
        raise ValueError(no_inverse(rig.projector.distortion))
    return depth_m, slope_m


def _doubles(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a copy in the only array type for which the kernels are compiled."""
    return np.array(values, dtype=np.float64, order="C")
