"""Register two pictures of a scene: find the motion between them to a fraction of a pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

COARSEST_PX = 40  # Smallest side in the pyramid, in which each picture has half the size.
AROUND_PX = 15  # The local mean over this window is subtracted, as changes of light are smooth.
TILES = 8  # The number of tiles per row and per column; sigma follows from their scatter.
ROUNDS = 6  # Two or three rounds are enough unless the motion is large.
CONVERGED_PX = 0.01
NEAR_PX = 0.5  # Optical flow is linear over this distance even in a sharp picture.
FAR_SIGMAS = 3.0  # Larger differences (highlights, clipped light, moving objects) get less weight.
# Slopes that both pictures share must be this much stronger (in squares) than all other slopes,
# which come from noise and from fringes that a non-linear camera leaves in sums of patterns.
SHARED = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureMotion:
    """The motion from one picture to another [px], x right and y down.

    `sigma_px` is the standard deviation of the length. In a direction in which the pictures have
    no structure (such as along an edge), the motion is unknown and set to 0; `known` is false if
    both directions are unknown.
    """

    x_px: float
    y_px: float
    sigma_px: float
    known: bool

    @property
    def length_px(self) -> float:
        """Length of the motion [px]."""
        return float(np.hypot(self.x_px, self.y_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A picture with its slopes, prepared for `register`."""

    picture: Float[np.ndarray, "h w"]
    valid: Bool[np.ndarray, "h w"]
    finest: "_Level"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """A picture and its slopes, each minus its local mean."""

    value: Float[np.ndarray, "h w"]
    x_slope: Float[np.ndarray, "h w"]
    y_slope: Float[np.ndarray, "h w"]
    valid: Float[np.ndarray, "h w"]  # 1 for valid pixels, else 0


def prepare(picture: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]) -> Prepared:
    """Prepare a picture for `register`, which ignores pixels that are not valid."""
    value = picture.astype(np.float32)
    finest = _level(value, valid.astype(np.float32))
    return Prepared(picture=value, valid=valid, finest=finest)


def _pyramid(prepared: Prepared) -> list[_Level]:
    """Return the pyramid of a picture, the smallest level first."""
    value, mask = prepared.picture, prepared.valid.astype(np.float32)
    levels = [prepared.finest]
    while min(value.shape) >= 2 * COARSEST_PX:
        share, value = cv2.pyrDown(mask), cv2.pyrDown(value * mask)
        value = value / np.maximum(share, 1e-3)
        mask = (share > 0.9).astype(np.float32)
        levels.append(_level(value, mask))
    return levels[::-1]


def _level(value: Float[np.ndarray, "h w"], mask: Float[np.ndarray, "h w"]) -> _Level:
    value = value * mask
    inner = cv2.erode(mask, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT)
    rim = AROUND_PX // 2  # Near the border the local mean is not comparable between the pictures.
    for edge in (np.s_[:rim], np.s_[-rim:], np.s_[:, :rim], np.s_[:, -rim:]):
        inner[edge] = 0
    x_slope, y_slope = (
        _less_around(cv2.Sobel(value, cv2.CV_32F, *order, scale=1 / 8) * inner, inner)
        for order in ((1, 0), (0, 1))
    )
    return _Level(value=_less_around(value, mask), x_slope=x_slope, y_slope=y_slope, valid=inner)


def _less_around(value: Float[np.ndarray, "h w"], mask: Float[np.ndarray, "h w"]):
    size = (AROUND_PX, AROUND_PX)
    share = np.maximum(cv2.blur(mask, size), 1e-3)
    return (value - cv2.blur(value, size) / share) * mask


def register(first: Prepared, second: Prepared) -> PictureMotion:
    """Return the motion from the first picture to the second, which has the same size.

    Each step solves the linear equations of optical flow for one motion of the whole picture:
    difference = slope . motion, with a separate brightness for each picture. Products of slopes are
    taken between the two pictures, whose noise is independent, so that noise does not count as
    structure. If the first result does not fit, steps go from coarse to fine, with and without a
    start by phase correlation, and the best fit is used. Sigma follows from the scatter between
    tiles of the picture.

    Leaves out: a roll about the optical axis, whose mean motion is 0; scenes of which only a part
    moved (the part with most structure decides); motions of over a tenth of the picture.

    Source: Lucas & Kanade, "An Iterative Image Registration Technique", IJCAI 1981 (optical flow);
    Kuglin & Hines, "The Phase Correlation Image Alignment Method", 1975.
    """
    motion, equations = _converged([(first.finest, second.finest)], np.zeros(2))
    if not equations.known.all() or np.abs(motion).max() > NEAR_PX:
        levels = list(zip(_pyramid(first), _pyramid(second), strict=True))
        start = _by_phase(first.finest, second.finest)
        ways = [(levels, np.zeros(2)), (levels, 0.5 ** (len(levels) - 1) * start)]
        results = [_converged(*way) for way in (*ways, (levels[-1:], start))]
        motion, equations = max(results, key=lambda result: result[1].likeness)
    x_px, y_px = equations.known_part(motion)
    return PictureMotion(
        x_px=x_px, y_px=y_px, sigma_px=equations.sigma_px, known=bool(equations.known.any())
    )


def _by_phase(first: _Level, second: _Level) -> Float[np.ndarray, "2"]:
    window = cv2.createHanningWindow(first.value.shape[::-1], cv2.CV_32F)
    # Pass copies, because OpenCV 5.0.0 multiplies its arguments by the window in place.
    start, _ = cv2.phaseCorrelate(first.value.copy(), second.value.copy(), window)
    return np.array(start, dtype=np.float64)


def _converged(levels, motion):
    """Return the motion after steps on each pair of levels, and the equations of the last step."""
    for number, (level, other) in enumerate(levels):
        motion = 2 * motion if number else motion
        for _ in range(ROUNDS):
            equations = _equations(level, other, motion)
            motion = motion + equations.step
            if np.abs(equations.step).max() < CONVERGED_PX:
                break
    return motion, equations


@dataclass(frozen=True, slots=True, kw_only=True)
class _Equations:
    step: Float[np.ndarray, "2"]
    axes: Float[np.ndarray, "2 2"]  # Directions, in columns
    known: Bool[np.ndarray, "2"]  # Whether the pictures have structure along each direction
    likeness: float  # Ratio of the slopes that both pictures share to all other slopes
    sigma_px: float

    def known_part(self, motion: Float[np.ndarray, "2"]) -> tuple[float, float]:
        x, y = self.axes @ np.where(self.known, self.axes.T @ motion, 0)
        return float(x), float(y)


def _equations(first: _Level, second: _Level, motion: Float[np.ndarray, "2"]) -> _Equations:
    """Linearise about a motion, and solve the equations along the directions with structure."""
    moved = _Level(
        value=_moved(second.value, motion),
        x_slope=_moved(second.x_slope, motion),
        y_slope=_moved(second.y_slope, motion),
        valid=(_moved(second.valid, motion) > 0.99).astype(np.float32),
    )
    valid = first.valid * moved.valid
    gain = _ratio(valid, first.value, moved.value)
    off = first.value - gain * moved.value
    weight = valid / (1 + (off / (FAR_SIGMAS * _spread(off, valid))) ** 2)
    slopes = first.x_slope, first.y_slope, gain * moved.x_slope, gain * moved.y_slope
    matrix = _tiled_products(weight, *slopes)
    x_slope, y_slope = (slopes[0] + slopes[2]) / 2, (slopes[1] + slopes[3]) / 2
    side = np.stack([_tiled(weight * x_slope * off), _tiled(weight * y_slope * off)], axis=-1)
    apart = slopes[0] - slopes[2], slopes[1] - slopes[3]
    alone = np.trace(_tiled_products(weight, *apart, *apart).sum(axis=0)) / 4
    shared, axes = np.linalg.eigh(matrix.sum(axis=0))
    known = shared > SHARED * alone + 1e-9
    inverse = axes @ np.diag(known / np.where(known, shared, 1)) @ axes.T
    step = inverse @ side.sum(axis=0)
    left = side - matrix @ step
    covariance = inverse @ (left.T @ left) @ inverse
    return _Equations(
        step=step,
        axes=axes,
        known=known,
        likeness=float(shared.sum() / (alone + 1e-9)),
        sigma_px=float(np.sqrt(np.trace(covariance))),
    )


def _moved(value: Float[np.ndarray, "h w"], motion: Float[np.ndarray, "2"]):
    """Shift a picture back by a motion; pixels from outside the picture are 0."""
    place = np.array([[1, 0, motion[0]], [0, 1, motion[1]]], dtype=np.float64)
    # OpenCV's cubic kernel shifts fine structure by up to 0.04 px; the linear one only blurs it.
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(value, place, value.shape[::-1], flags=flags)


def _ratio(weight, value, other) -> float:
    """Return the factor by which the first picture is brighter than the other."""
    return float(np.vdot(weight * value, other) / max(float(np.vdot(weight * other, other)), 1e-9))


def _spread(off, valid) -> float:
    """Return a robust standard deviation of differences, computed from their median size."""
    sizes = np.abs(off[valid > 0][::7])
    return 1.4826 * float(np.median(sizes)) + 1e-6 if len(sizes) else 1.0


def _tiled(value: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " n"]:
    """Return the sum of an image over each tile."""
    y, x = ((np.arange(TILES) * size) // TILES for size in value.shape)
    return np.add.reduceat(np.add.reduceat(value, y, axis=0), x, axis=1).ravel().astype(float)


def _tiled_products(weight, x1, y1, x2, y2) -> Float[np.ndarray, "n 2 2"]:
    """Return the sum over each tile of the products of two slopes, as symmetric matrices."""
    xx, yy = _tiled(weight * x1 * x2), _tiled(weight * y1 * y2)
    xy = _tiled(weight * (x1 * y2 + y1 * x2)) / 2
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)
