"""The pictures against what was rendered into them: edges lie where the geometry has them.

Leaves out: a colour picture whose parts can hardly be told from the bin, or that shows few parts in
few pixels: whether it is another scene's, seen from the same place; colours and brightness; a shift
by one pixel.
"""

from collections.abc import Iterator

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Bool, Float
from scipy import ndimage

from .evidence import Evidence

BEND = 2e-3  # At a crease, inverse depth bends by more over three pixels, as a share of its median.
# The agreement without a shift, give or take a pixel, is this share of the best of all shifts: 1 in
# all sound pictures; after a shift by five pixels 0.1 to 0.55, by three 0.5 to 0.9.
IN_PLACE = 0.92
# The best shift stands out of all by more: by 7.5 and more in sound pictures of 160 x 120 pixels,
# by 50 and more in those of 1032 x 772. Chance alone gives 5.
LEAST_SIGMAS = 6.0
# Edges correlate with parts' outlines, near these: sound pictures show 0.34 and more, also white
# parts in a white bin; those of another scene 0.04 and less. Over fewer pixels it scatters.
OUTLINE_CORRELATION, NEAR_LEAST_PX = 0.06, 6000
_DARK_DN = 8.0  # Eight bits resolve about this: noise in the dark is no edge.
_SMOOTH_PX, _LINE_PX = 0.7, 1.0
_WIDE_PX = 6.0  # What is as wide as this is no edge.
_AROUND_PX = 8
_SHIFTS = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)]


def picture_problems(scene: Evidence) -> Iterator[str]:
    """Pictures that do not show this scene."""
    outline = _outline(scene)
    geometry = _blurred((outline | _creases(scene)).astype(np.float32), _LINE_PX)
    color = _edges(scene.image["rgb"])
    yield from _placed("rgb/000000.png", color, geometry, "the edges of depth and masks")
    light = _blurred(np.minimum(scene.modulation, 1.0).astype(np.float32), _SMOOTH_PX)
    gray = _edges(scene.image["gray_sl"])
    yield from _placed("gray_sl/000000.png", gray, _gradient(light), "the edges of modulation_sl")
    yield from _outlined(color, outline)


def _outlined(color: Float[np.ndarray, "h w"], outline: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    """Whether parts end where they do: a bin seen from the same place looks alike without them."""
    window = np.ones((2 * _AROUND_PX + 1,) * 2, dtype=np.uint8)
    near = cv2.dilate(outline.astype(np.uint8), window) > 0
    if near.sum() < NEAR_LEAST_PX:
        return
    edges = _sharp(color)[near]
    ends = _sharp(_blurred(outline.astype(np.float32), _LINE_PX))
    correlation = max(_correlation(np.roll(ends, shift, (0, 1))[near], edges) for shift in _SHIFTS)
    if correlation < OUTLINE_CORRELATION:
        yield (
            f"rgb/000000.png has no edges where parts end (correlation {correlation:.2f}): the "
            "picture may be of another scene"
        )


def _placed(
    name: str, edges: Float[np.ndarray, "h w"], where: Float[np.ndarray, "h w"], must: str
) -> Iterator[str]:
    """Whether edges agree best with others where they are."""
    if edges.std() == 0 or where.std() == 0:
        yield f"{name} shows nothing, or {must} do not"
        return
    agreement = _agreement(_sharp(edges), _sharp(where))
    here = max(agreement[shift] for shift in _SHIFTS)
    y, x = np.unravel_index(int(agreement.argmax()), agreement.shape)
    best, spread = agreement[y, x], agreement.std()
    if best < LEAST_SIGMAS * spread:
        yield f"{name} does not show {must}"
    elif here < IN_PLACE * best:
        h, w = agreement.shape
        down, right = (int(y) + h // 2) % h - h // 2, (int(x) + w // 2) % w - w // 2
        yield f"{name} shows {must} {right} pixels to the right and {down} down from their place"


def _agreement(
    a: Float[np.ndarray, "h w"], b: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Correlation of `a` with `b` shifted by [down, right], the picture's ends joined."""
    spectrum = scipy.fft.rfft2(a - a.mean()) * np.conj(scipy.fft.rfft2(b - b.mean()))
    return scipy.fft.irfft2(spectrum, a.shape) / (a.std() * b.std() * a.size)


def _sharp(image: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    return image - _blurred(image, _WIDE_PX)


def _edges(picture: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Relative changes of brightness, of all colours together."""
    bands = picture.reshape(*picture.shape[:2], -1).astype(np.float32)
    squared = np.zeros(picture.shape[:2], dtype=np.float32)
    for k in range(bands.shape[2]):
        smooth = _blurred(np.ascontiguousarray(bands[..., k]), _SMOOTH_PX)
        squared += _gradient(np.log(smooth + np.float32(_DARK_DN))) ** 2
    return np.sqrt(squared)


def _gradient(image: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    return np.hypot(*(cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx) for dx in (0, 1)))


def _blurred(image: Float[np.ndarray, "h w"], sigma_px: float) -> Float[np.ndarray, "h w"]:
    return cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)


def _outline(scene: Evidence) -> Bool[np.ndarray, "h w"]:
    """Pixels on either side of a border of a part."""
    border = np.zeros(scene.instance.shape, dtype=bool)
    for axis in (0, 1):
        turn = np.diff(scene.instance, axis=axis) != 0
        first, second = [slice(None)] * 2, [slice(None)] * 2
        first[axis], second[axis] = slice(0, -1), slice(1, None)
        border[tuple(first)] |= turn
        border[tuple(second)] |= turn
    return border


def _creases(scene: Evidence) -> Bool[np.ndarray, "h w"]:
    """Where depth has a step or a bend: inverse depth of a plane is linear in the picture."""
    depth = scene.image["depth"]
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=known)
    if not known.any():
        return known
    bend = np.maximum(
        *(np.abs(ndimage.convolve1d(inverse, [1.0, -2.0, 1.0], axis=axis)) for axis in (0, 1))
    )
    return bend > BEND * np.median(inverse[known])


def _correlation(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    spread = a.std() * b.std()
    return float(((a - a.mean()) * (b - b.mean())).mean() / spread) if spread > 0 else 0.0
