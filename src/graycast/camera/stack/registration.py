"""Motion of one picture of a scene against another, to a small part of a pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

COARSEST_PX = 40  # Each picture of the pyramid is half of the one before; none is smaller.
AROUND_PX = 15  # Light is smooth over this length, so what differs by more of it is no motion.
TILES = 8  # The picture has this many tiles across and down; how they differ gives sigma.
ROUNDS = 6  # It converges in two or three, unless the motion is large.
CONVERGED_PX = 0.01
NEAR_PX = 0.5  # Optical flow is linear over this length even where the picture is sharp.
FAR_SIGMAS = 3.0  # What differs by more has little weight: highlights, clipped light, passers-by.
# The slopes that both pictures share must be this much stronger (in squares) than those that they
# do not share: noise, and fringes that a camera which is not linear leaves in sums of patterns.
SHARED = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureMotion:
    """The motion from one picture to another [px], x right and y down.

    `sigma_px` is that of the length. Of a direction in which the pictures have no structure (a
    vertical edge is the same above and below) nothing is known, and the motion along it is 0;
    `known` is false if that is so of both.
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
    """A picture that is ready for `register`."""

    picture: Float[np.ndarray, "h w"]
    valid: Bool[np.ndarray, "h w"]
    finest: "_Level"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """A picture and its slopes, each less its mean around."""

    value: Float[np.ndarray, "h w"]
    x_slope: Float[np.ndarray, "h w"]
    y_slope: Float[np.ndarray, "h w"]
    valid: Float[np.ndarray, "h w"]  # 1 or 0


def prepare(picture: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]) -> Prepared:
    """Return a picture that is ready for `register`; pixels that are not valid take no part."""
    value = picture.astype(np.float32)
    finest = _level(value, valid.astype(np.float32))
    return Prepared(picture=value, valid=valid, finest=finest)


def _pyramid(prepared: Prepared) -> list[_Level]:
    """The picture and ever smaller ones, the smallest first."""
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
    rim = AROUND_PX // 2  # There the mean around is that of a part, which is no part of the motion.
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
    """Return the motion that carries the first picture onto the second, of the same size.

    Each step solves the linear equations of optical flow for one motion of the whole picture:
    difference = slope . motion, with a brightness of its own for each picture. The products of
    slopes are taken between both pictures, whose noise is not the same, so that noise is no
    structure. Where the pictures do not fit at once, this is done from coarse to fine, and
    from where the phases of their spectra correlate, and the best fit is taken. Sigma comes from
    how the tiles of the picture disagree.

    Leaves out: a roll about the optical axis, whose motion is 0 in the mean; scenes of which a part
    moved, where most of the structure decides; motions of over a tenth of the picture.

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
    # OpenCV 5.0.0 multiplies its arguments by the window, in place.
    start, _ = cv2.phaseCorrelate(first.value.copy(), second.value.copy(), window)
    return np.array(start, dtype=np.float64)


def _converged(levels, motion):
    """The motion after steps on each pair of levels, and the equations of the last step."""
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
    axes: Float[np.ndarray, "2 2"]  # directions, in columns
    known: Bool[np.ndarray, "2"]  # whether there is structure along each
    likeness: float  # the slopes that both pictures share, over those that they do not
    sigma_px: float

    def known_part(self, motion: Float[np.ndarray, "2"]) -> tuple[float, float]:
        x, y = self.axes @ np.where(self.known, self.axes.T @ motion, 0)
        return float(x), float(y)


def _equations(first: _Level, second: _Level, motion: Float[np.ndarray, "2"]) -> _Equations:
    """The linear equations about a motion, and their solution where there is structure."""
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
    """The picture taken back by a motion; 0 where it ends."""
    place = np.array([[1, 0, motion[0]], [0, 1, motion[1]]], dtype=np.float64)
    # OpenCV's cubic kernel moves fine structure by up to 0.04 px; the linear one only blurs it.
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(value, place, value.shape[::-1], flags=flags)


def _ratio(weight, value, other) -> float:
    """Return the factor by which a picture is brighter than the other."""
    return float(np.vdot(weight * value, other) / max(float(np.vdot(weight * other, other)), 1e-9))


def _spread(off, valid) -> float:
    """Deviation of the differences, from the median of their sizes."""
    sizes = np.abs(off[valid > 0][::7])
    return 1.4826 * float(np.median(sizes)) + 1e-6 if len(sizes) else 1.0


def _tiled(value: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " n"]:
    """Sums over the tiles."""
    y, x = ((np.arange(TILES) * size) // TILES for size in value.shape)
    return np.add.reduceat(np.add.reduceat(value, y, axis=0), x, axis=1).ravel().astype(float)


def _tiled_products(weight, x1, y1, x2, y2) -> Float[np.ndarray, "n 2 2"]:
    """Sums over the tiles of the products of two slopes, symmetric."""
    xx, yy = _tiled(weight * x1 * x2), _tiled(weight * y1 * y2)
    xy = _tiled(weight * (x1 * y2 + y1 * x2)) / 2
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)
