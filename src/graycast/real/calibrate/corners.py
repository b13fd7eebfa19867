"""Measurement of a board's inner corners in camera (to about 0.01 px) and projector."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.special import erf

from ...base.robust import robust_sigma
from .board import Board, CalibrationError

MIN_CORNERS = 8  # A pose and a homography need only four; more are safer.
REFINE_REACH = 0.45  # share of a square; a larger window would contain the next edges
REFINE_REACH_PX = 15.0  # A larger window costs time, and distortion bends its edges.
REFINE_ITERATIONS = 20
SMOOTH_PX = 0.8  # A blur of this standard deviation makes sharp edges wider than a pixel.
MIN_BLUR_PX = 0.5
MIN_CONTRAST = 0.05  # half of the step from dark to bright, as a share of the picture's range
MAX_MOVE = 0.2  # A corner is rejected if refinement moves it by a larger share of a square.
CODE_REACH = 0.9  # in squares; around every inner corner, the board extends by a whole square
MIN_SHARE = 0.3  # This share of the pixels around a corner must be decoded and agree.
MIN_PIXELS = 20
CODE_ROUNDS = 12
CODE_OUTLIER = 3.0  # A value is an outlier beyond this many robust standard deviations.


@dataclass(frozen=True, slots=True, kw_only=True)
class Corners:
    """Inner corners of one board in one picture.

    `id` indexes `Board.corners_m`; `position_px` is (x, y). At corner i, `px_per_square[i]` maps a
    step on the board, in squares, to a step in the picture.
    """

    id: Int[np.ndarray, " n"]
    position_px: Float[np.ndarray, "n 2"]
    px_per_square: Float[np.ndarray, "n 2 2"]

    def __post_init__(self) -> None:
        for array in (self.id, self.position_px, self.px_per_square):
            array.flags.writeable = False


def find_corners(image: Shaped[np.ndarray, "h w"], board: Board) -> Corners:
    """Find the inner corners of a board in an evenly lit picture.

    OpenCV finds the board. Each corner is then refined by a fit of two blurred edges, because
    OpenCV's sub-pixel positions are off by 0.05 to 0.1 px in sharp pictures.

    Args:
        image: grey levels of any scale.

    Raises:
        CalibrationError: the picture does not show such a board, or shows too little of it.
    """
    grey = _to_range(image)
    byte = np.rint(255 * grey).astype(np.uint8)
    start = _find_chessboard(byte, board) if board.marker_m is None else _find_charuco(byte, board)
    if start is None:
        raise CalibrationError(_no_board(byte, board))
    id_, start_px = start
    px_per_square = px_per_square_of(board, id_, start_px)
    reach = REFINE_REACH
    if board.marker_m is not None:  # The window must exclude the markers.
        reach = min(reach, 0.65 * (1 - board.marker_m / board.square_m))
    position_px, good = refine_corners(grey, start_px, px_per_square, reach=reach)
    if good.sum() < MIN_CORNERS:
        count = f"{good.sum()} of {board.corner_count} corners are sharp enough"
        raise CalibrationError(
            f"{count}, {MIN_CORNERS} are needed: the picture may be blurred or too dark"
        )
    return Corners(id=id_[good], position_px=position_px[good], px_per_square=px_per_square[good])


def refine_corners(
    image: Float[np.ndarray, "h w"],
    start_px: Float[np.ndarray, "n 2"],
    px_per_square: Float[np.ndarray, "n 2 2"],
    *,
    reach: float = REFINE_REACH,
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Fit two crossing edges to each corner; return positions [px] and a mask of the good fits.

    The model is `I(p) = (m + c erf(u / s) erf(v / s)) (1 + g . (p - p0))`, where u and v are the
    distances from two lines through p0 with independent angles, m is the mean grey level, c the
    contrast, s the blur and g a gradient of the light. Gauss-Newton steps find the nine unknowns
    from the pixels within `reach` squares and 15 px.

    The picture is smoothed first: if a sharp edge runs along the pixel rows, the grey levels do not
    vary smoothly with the position of the edge, and the fit may be off by half a pixel.

    Leaves out: edges bent by distortion, which shift corners by 0.005 px with the lenses tried.
    """
    offset, weight = _window(start_px, px_per_square, reach)
    centre = np.rint(start_px).astype(np.intp)
    pixel = centre[:, None] + offset
    inside = ((pixel >= 0) & (pixel < [image.shape[1], image.shape[0]])).all(axis=-1)
    weight = weight * inside
    x, y = np.clip(pixel, 0, [image.shape[1] - 1, image.shape[0] - 1]).transpose(2, 0, 1)
    value = cv2.GaussianBlur(image, (0, 0), SMOOTH_PX)[y, x]
    unknown = _first_guess(start_px - centre, px_per_square, offset, value, weight)
    for step in range(REFINE_ITERATIONS):
        residual, jacobian = _edges(unknown, offset, value)
        weighted = jacobian * weight[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, jacobian)
        # First steps are damped, as the guess may be half a pixel off; 1e-12 avoids singularity.
        damping = np.einsum("nii->ni", normal) * (0.05 if step < 4 else 1e-9) + 1e-12
        normal += damping[..., None] * np.eye(normal.shape[-1])
        gradient = np.einsum("nki,nk->ni", weighted, residual)
        change = np.linalg.solve(normal, gradient[..., None])[..., 0]
        unknown = unknown - change
        unknown[:, 4] = np.clip(unknown[:, 4], MIN_BLUR_PX, REFINE_REACH_PX)
        if step >= 4 and np.abs(change[:, :2]).max() < 1e-4:
            break
    position_px = centre + unknown[:, :2]
    residual, _ = _edges(unknown, offset, value)
    misfit = np.sqrt((weight * residual**2).sum(axis=1) / np.maximum(weight.sum(axis=1), 1))
    contrast = np.abs(unknown[:, 6])
    in_squares = np.einsum("nij,nj->ni", np.linalg.inv(px_per_square), position_px - start_px)
    good = (np.abs(in_squares) < MAX_MOVE).all(axis=1) & (contrast > MIN_CONTRAST)
    good &= (misfit < 0.5 * contrast) & (weight.sum(axis=1) >= 12)
    return position_px, good


def _to_range(image: Shaped[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Scale grey levels so that their 1st and 99.5th percentiles are 0 and 1, and clip them."""
    if not np.isfinite(image).all():
        raise CalibrationError("the white picture has values that are not finite")
    low, high = np.percentile(image, [1.0, 99.5])
    if not high > low:
        raise CalibrationError(
            f"the white picture is {low:g} everywhere: check that it is the white frame"
        )
    return np.clip((image.astype(np.float64) - low) / (high - low), 0.0, 1.0)


def _find_chessboard(byte, board):
    size = (board.squares_x - 1, board.squares_y - 1)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    is_there, position = cv2.findChessboardCornersSB(byte, size, flags=flags)
    if not is_there:  # OpenCV's older detector finds small boards in noise or speckle.
        is_there, position = cv2.findChessboardCorners(byte, size)
    if not is_there:
        return None
    return np.arange(board.corner_count), position.reshape(-1, 2).astype(np.float64)


def _find_charuco(byte, board):
    detector = cv2.aruco.CharucoDetector(board.charuco())
    position, id_, _, _ = detector.detectBoard(byte)
    if id_ is None or len(id_) < MIN_CORNERS:
        return None
    id_ = np.asarray(id_).ravel().astype(np.intp)
    position = np.asarray(position).reshape(-1, 2).astype(np.float64)
    across = board.corners_m[id_, :2] - board.corners_m[id_, :2].mean(axis=0)
    return (id_, position) if np.linalg.matrix_rank(across) == 2 else None


def _no_board(byte, board: Board) -> str:
    inner = f"{board.squares_x - 1} x {board.squares_y - 1}"
    squares = f"{board.squares_x} x {board.squares_y}"
    if board.marker_m is not None:
        return (
            f"no ChArUco board of {squares} squares, {board.dictionary}, is in the white picture: "
            "check counts and dictionary, try ':legacy', light the board, or show more of it"
        )
    larger = Board(
        squares_x=board.squares_x + 1, squares_y=board.squares_y + 1, square_m=board.square_m
    )
    if _find_chessboard(byte, larger) is not None:
        return (
            f"the picture shows {squares} inner corners: --board counts squares, "
            f"so give {larger.squares_x}x{larger.squares_y}"
        )
    return (
        f"no chessboard of {squares} squares ({inner} inner corners) is in the white picture: "
        "show the whole board, evenly lit, with a white margin"
    )


def px_per_square_of(board: Board, id_, position_px) -> Float[np.ndarray, "n 2 2"]:
    """Return the Jacobian of the homography from board (in squares) to picture at each corner."""
    square = board.corners_m[id_, :2] / board.square_m
    H, _ = cv2.findHomography(square, position_px)
    if H is None:
        raise CalibrationError("the corners found lie on one line")
    w = square @ H[2, :2] + H[2, 2]
    image = (square @ H[:2, :2].T + H[:2, 2]) / w[:, None]
    return (H[None, :2, :2] - image[:, :, None] * H[None, None, 2, :2]) / w[:, None, None]


def _window(
    start_px, px_per_square, reach: float
) -> tuple[Int[np.ndarray, "k 2"], Float[np.ndarray, "n k"]]:
    """Return pixel offsets from the nearest pixel, and weights of each corner: 1 on its disc or 0.

    The disc is a circle on the board with a radius of `reach` squares, an ellipse in the picture.
    """
    widest = reach * np.linalg.norm(px_per_square, axis=(1, 2)).max()
    radius = int(np.ceil(min(widest, REFINE_REACH_PX))) + 1
    step = np.arange(-radius, radius + 1)
    offset = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    to_corner = offset - (start_px - np.rint(start_px))[:, None]
    in_squares = np.einsum("nij,nkj->nki", np.linalg.inv(px_per_square), to_corner)
    within = np.square(in_squares).sum(axis=-1) < reach**2
    within &= np.square(to_corner).sum(axis=-1) < REFINE_REACH_PX**2
    used = within.any(axis=0)
    return offset[used], within[:, used].astype(np.float64)


def _first_guess(position, px_per_square, offset, value, weight) -> Float[np.ndarray, "n 9"]:
    """Return each corner's x, y, angles of two normals, blur, mean, contrast, gradient x and y."""
    n = len(position)
    normal = np.arctan2(px_per_square[:, 0], -px_per_square[:, 1])  # angles of the edges' normals
    guess = np.zeros((n, 9))
    guess[:, :2], guess[:, 2:4], guess[:, 4] = position, normal, 1.0
    guess[:, 5] = (weight * value).sum(axis=1) / weight.sum(axis=1)
    guess[:, 6] = 1.0
    _, jacobian = _edges(guess, offset, value)
    checker = weight * jacobian[..., 6]  # about +1 or -1 in each quadrant
    guess[:, 6] = (checker * (value - guess[:, 5:6])).sum(axis=1) / (checker**2).sum(axis=1)
    return guess


def _edges(unknown, offset, value) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "n k 9"]]:
    """Return the residual of the two-edge model at each pixel, and its Jacobian."""
    x, y, a, b, s, mean, contrast, gx, gy = unknown.T[..., None]
    dx, dy = offset[:, 0] - x, offset[:, 1] - y
    u, v = np.cos(a) * dx + np.sin(a) * dy, np.cos(b) * dx + np.sin(b) * dy
    U, V = erf(u / s), erf(v / s)
    bell = 2 / np.sqrt(np.pi) / s
    dU, dV = bell * np.exp(-((u / s) ** 2)), bell * np.exp(-((v / s) ** 2))
    light = 1 + gx * dx + gy * dy
    base = mean + contrast * U * V
    by_u, by_v = contrast * light * dU * V, contrast * light * U * dV
    jacobian = np.stack(
        [
            -by_u * np.cos(a) - by_v * np.cos(b) - base * gx,
            -by_u * np.sin(a) - by_v * np.sin(b) - base * gy,
            by_u * (-np.sin(a) * dx + np.cos(a) * dy),
            by_v * (-np.sin(b) * dx + np.cos(b) * dy),
            -(by_u * u + by_v * v) / s,
            light,
            light * U * V,
            base * dx,
            base * dy,
        ],
        axis=-1,
    )
    return base * light - value, jacobian


# --- projector corners ----------------------------------------------------------------------------


def projector_corners(
    corners: Corners,
    column: Float[np.ndarray, "h w"],
    row: Float[np.ndarray, "h w"],
    *,
    sigma_column: Float[np.ndarray, "h w"] | None = None,
    sigma_row: Float[np.ndarray, "h w"] | None = None,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Return the projector's column and row at each corner of the board.

    The board is flat, so near a corner, the code is a smooth function of the camera pixel on light
    and dark squares. For each axis, a quadratic is fitted robustly to a disc of 0.9 squares around
    the corner and evaluated at the corner. It follows perspective and both lenses to 0.001 px, and
    many pixels average out the rounding of a plain Gray code.

    Args:
        column: decoded projector column [px]; NaN where unknown.
        row: decoded projector row [px]; NaN where unknown.
        sigma_column: standard deviation of `column`, for the weights; None means equal weights.
        sigma_row: standard deviation of `row`, likewise.

    Returns:
        Positions (x, y) [px], and at each corner the matrix that maps a small shift in the camera's
        picture to a shift in the projector's picture. Both are NaN where fewer than 30 % of the
        pixels around a corner are decoded and agree.

    Source: D. Moreno and G. Taubin, "Simple, Accurate, and Robust Projector-Camera Calibration",
    3DIMPVT 2012. They fit one homography to columns and rows.
    """
    n = len(corners.id)
    position_px, per_camera_px = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    for i in range(n):
        pixel = disc(corners.position_px[i], corners.px_per_square[i], *column.shape)
        for axis, (code, sigma) in enumerate(((column, sigma_column), (row, sigma_row))):
            position_px[i, axis], per_camera_px[i, axis] = read_at(
                corners.position_px[i], pixel, code, sigma
            )
    undecoded = ~np.isfinite(position_px).all(axis=1)
    position_px[undecoded] = per_camera_px[undecoded] = np.nan
    return position_px, per_camera_px


def disc(
    centre: Float[np.ndarray, "2"], px_per_square: Float[np.ndarray, "2 2"], h: int, w: int
) -> Int[np.ndarray, "k 2"]:
    """Return the pixels (x, y) that are within `CODE_REACH` squares of a corner on the board."""
    radius = CODE_REACH * np.linalg.norm(px_per_square, axis=1)
    low = np.maximum(np.floor(centre - radius), 0).astype(np.intp)
    high = np.minimum(np.ceil(centre + radius) + 1, [w, h]).astype(np.intp)
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    pixel = np.stack([x.ravel(), y.ravel()], axis=1)
    in_squares = (pixel - centre) @ np.linalg.inv(px_per_square).T
    return pixel[np.square(in_squares).sum(axis=1) < CODE_REACH**2]


def read_at(
    centre: Float[np.ndarray, "2"],
    pixel: Int[np.ndarray, "k 2"],
    code: Float[np.ndarray, "h w"],
    sigma: Float[np.ndarray, "h w"] | None,
) -> tuple[float, Float[np.ndarray, "2"]]:
    """Return value and gradient, at `centre`, of a robust quadratic fit to the code around it."""
    nothing = (np.nan, np.full(2, np.nan))
    value = code[pixel[:, 1], pixel[:, 0]].astype(np.float64)
    weight = np.ones(len(pixel))
    if sigma is not None:
        weight = 1 / np.square(sigma[pixel[:, 1], pixel[:, 0]].astype(np.float64))
    known = np.isfinite(value) & np.isfinite(weight)
    enough = max(MIN_PIXELS, MIN_SHARE * len(pixel))
    if known.sum() < enough:
        return nothing
    value, weight = value[known], weight[known] / weight[known].mean()
    unit_px = np.abs(pixel - centre).max()  # With this unit, all powers have a similar scale.
    offset = (pixel[known] - centre) / unit_px
    x, y = offset[:, 0], offset[:, 1]
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    keep, coefficient = _robust_fit(basis, value, weight)
    if keep.sum() < enough:
        return nothing
    normal = (basis[keep] * weight[keep, None]).T @ basis[keep]
    if np.linalg.cond(normal) > 1e8:  # Pixels on only one side do not determine the fit.
        return nothing
    return float(coefficient[0]), coefficient[1:3] / unit_px


def _robust_fit(basis, value, weight):
    """Return a mask of the values that agree with a smooth fit, and the coefficients of the fit.

    A first fit minimises absolute deviations by reweighting, so that it tolerates gross errors in
    fewer than half of the pixels. Then pixels beyond three robust standard deviations are left out.
    """
    robust, before = weight, np.full(basis.shape[1], np.inf)
    for _ in range(CODE_ROUNDS):
        coefficient = _solve(basis, value, robust)
        if np.abs(coefficient - before).max() < 1e-3:
            break
        before = coefficient
        size = np.abs(value - basis @ coefficient)
        robust = weight / np.maximum(size, 0.3)
    deviation = robust_sigma(size)
    keep = size <= CODE_OUTLIER * max(deviation, 0.01)
    return keep, _solve(basis[keep], value[keep], weight[keep])


def _solve(basis, value, weight):
    weighted = basis * weight[:, None]
    ridge = 1e-12 * np.eye(basis.shape[1]) * weight.sum()
    return np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ value)
