"""The projector coordinates of a board's corners, interpolated in the decoded code."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...base.robust import robust_sigma
from .corners import Corners

REACH = 0.9  # It is in squares: every inner corner has a whole square around it on the board.
MIN_SHARE = 0.3  # This share of the pixels around a corner must be decoded and agree.
MIN_PIXELS = 20
ROUNDS = 12
OUTLIER = 3.0  # A value is an outlier beyond so many robust standard deviations.


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorCorners:
    """Projector coordinates (x, y) of corners and their standard deviation; NaN where undecoded.

    `per_camera_px[i]` maps a step in the camera's picture to one in the projector's, at corner i:
    an error of the camera's corner is carried over by it.
    """

    position_px: Float[np.ndarray, "n 2"]
    sigma_px: Float[np.ndarray, "n 2"]
    per_camera_px: Float[np.ndarray, "n 2 2"]

    def __post_init__(self) -> None:
        for array in (self.position_px, self.sigma_px, self.per_camera_px):
            array.flags.writeable = False


def projector_corners(
    corners: Corners,
    column: Float[np.ndarray, "h w"],
    row: Float[np.ndarray, "h w"],
    *,
    sigma_column: Float[np.ndarray, "h w"] | None = None,
    sigma_row: Float[np.ndarray, "h w"] | None = None,
) -> ProjectorCorners:
    """The projector's column and row at each corner of the board.

    The board is flat, so near a corner the code is a smooth function of the camera pixel, light and
    dark squares alike: a quadratic is fitted to each axis over the disc of 0.9 squares around the
    corner and read at the corner. It follows perspective and both lenses to 0.001 px there,
    and many pixels share the rounding of a plain Gray code. Gross errors are taken out in rounds.

    Args:
        column: decoded projector column [px]; NaN where unknown.
        row: likewise the row.
        sigma_column: its standard deviation, which weights the pixels; None weights all alike.
        sigma_row: likewise of the row.

    Returns:
        Positions; NaN where fewer than 30 % of the pixels around a corner are decoded and agree.
        Their standard deviations take the pixels' errors for independent: those of a plain Gray
        code are not, where its stripes run along the pixels, and sigma is then too small.

    Source: D. Moreno and G. Taubin, "Simple, Accurate, and Robust Projector-Camera Calibration",
    3DIMPVT 2012, for the idea; they fit a homography, to columns and rows together.
    """
    n = len(corners.id)
    position_px, sigma_px = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    per_camera_px = np.full((n, 2, 2), np.nan)
    for i in range(n):
        pixel = _disc(corners.position_px[i], corners.px_per_square[i], *column.shape)
        for axis, (code, sigma) in enumerate(((column, sigma_column), (row, sigma_row))):
            position_px[i, axis], sigma_px[i, axis], per_camera_px[i, axis] = _read_at(
                corners.position_px[i], pixel, code, sigma
            )
    undecoded = ~np.isfinite(position_px).all(axis=1)
    position_px[undecoded] = sigma_px[undecoded] = per_camera_px[undecoded] = np.nan
    return ProjectorCorners(position_px=position_px, sigma_px=sigma_px, per_camera_px=per_camera_px)


def _disc(
    centre: Float[np.ndarray, "2"], px_per_square: Float[np.ndarray, "2 2"], h: int, w: int
) -> Int[np.ndarray, "k 2"]:
    """Pixels (x, y) of the picture within `REACH` squares of a corner, measured on the board."""
    radius = REACH * np.linalg.norm(px_per_square, axis=1)
    low = np.maximum(np.floor(centre - radius), 0).astype(np.intp)
    high = np.minimum(np.ceil(centre + radius) + 1, [w, h]).astype(np.intp)
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    pixel = np.stack([x.ravel(), y.ravel()], axis=1)
    in_squares = (pixel - centre) @ np.linalg.inv(px_per_square).T
    return pixel[np.square(in_squares).sum(axis=1) < REACH**2]


def _read_at(
    centre: Float[np.ndarray, "2"],
    pixel: Int[np.ndarray, "k 2"],
    code: Float[np.ndarray, "h w"],
    sigma: Float[np.ndarray, "h w"] | None,
) -> tuple[float, float, Float[np.ndarray, "2"]]:
    """A robust quadratic through the code around `centre`: value, its deviation, slope there."""
    nothing = (np.nan, np.nan, np.full(2, np.nan))
    value = code[pixel[:, 1], pixel[:, 0]].astype(np.float64)
    weight = np.ones(len(pixel))
    if sigma is not None:
        weight = 1 / np.square(sigma[pixel[:, 1], pixel[:, 0]].astype(np.float64))
    known = np.isfinite(value) & np.isfinite(weight)
    enough = max(MIN_PIXELS, MIN_SHARE * len(pixel))
    if known.sum() < enough:
        return nothing
    value, weight = value[known], weight[known] / weight[known].mean()
    unit_px = np.abs(pixel - centre).max()  # keeps the powers of one size
    offset = (pixel[known] - centre) / unit_px
    x, y = offset[:, 0], offset[:, 1]
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    keep, coefficient = _robust_fit(basis, value, weight)
    if keep.sum() < enough:
        return nothing
    normal = (basis[keep] * weight[keep, None]).T @ basis[keep]
    if np.linalg.cond(normal) > 1e8:  # decoded on one side only
        return nothing
    residual = value[keep] - basis[keep] @ coefficient
    variance = (weight[keep] * residual**2).sum() / (keep.sum() - basis.shape[1])
    deviation = float(np.sqrt(variance * np.linalg.inv(normal)[0, 0]))
    return float(coefficient[0]), deviation, coefficient[1:3] / unit_px


def _robust_fit(basis, value, weight):
    """Which values agree with the smooth fit, and its coefficients by least squares of those.

    Least absolute deviations first (reweighted), which half of the pixels cannot pull away; then
    those beyond three robust deviations are left out.
    """
    robust, before = weight, np.full(basis.shape[1], np.inf)
    for _ in range(ROUNDS):
        coefficient = _solve(basis, value, robust)
        if np.abs(coefficient - before).max() < 1e-3:
            break
        before = coefficient
        size = np.abs(value - basis @ coefficient)
        robust = weight / np.maximum(size, 0.3)
    deviation = robust_sigma(size)
    keep = size <= OUTLIER * max(deviation, 0.01)
    return keep, _solve(basis[keep], value[keep], weight[keep])


def _solve(basis, value, weight):
    weighted = basis * weight[:, None]
    ridge = 1e-12 * np.eye(basis.shape[1]) * weight.sum()
    return np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ value)
