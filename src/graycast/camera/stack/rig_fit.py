"""Check whether a rig fits a stack, or would fit with turned pictures or inverted R and T.

The check uses data that depth does not use. If both axes are coded, this is the other coordinate of
each pixel. With one axis, it is the edge of the projector's picture across the stripes, if the
camera sees it: the rig must put the last lit pixels on the projector's first and last row.

If the camera sees no such edge, the check compares the shares of points in the working range and in
the projector's picture, for the stated R and T and for inverted ones. If the shares do not differ,
`doubts` yields a note. The sides of shadows do not help: inverting R and T exchanges near and far
as well as the side of the projector, so shadows are still on the expected sides.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.frames import inverse, transform_points
from ...rig.optics import project
from ...rig.pair import Rig
from ...rig.pattern import Code
from ..decode import CodeMap, DepthMap, Reason, meet_planes, triangulation_axis

SAMPLES = 4000
LEAST = 30  # The fewest samples that suffice to check the rig.
# A sample fits if its error is below NEAR_PX or below the share NEAR of the projector's size.
NEAR_PX, NEAR = 3.0, 0.01
FITS = 0.3  # The rig fits if this share of the samples fits.
TIMES = 4.0  # With a change of pictures or rig, this many times as many samples must fit.
# Inverted R and T are certain if the first share of the points is then in range and lit, and less
# than half of that share with the stated R and T; they are possible with the second share.
SURELY_LIT, POSSIBLE = 0.9, 0.5
MISPLACED_PX = 3.0  # A larger median epipolar residual means that the rig does not fit the stack.
OUT_OF_RANGE = 0.3  # The rig is doubtful if a larger share of the decoded pixels is out of range.
RIM_PX = 5  # The outermost decoded pixel may be this far inside the outermost lit one.

# Each remedy for the pictures, and the matrix by which it moves a pixel (x, y) about their middle.
_TURNS = {
    "turn the pictures by 180 degrees": ((-1, 0), (0, -1)),
    "mirror the pictures left to right": ((-1, 0), (0, 1)),
    "mirror the pictures upside down": ((1, 0), (0, -1)),
    "turn the pictures by 90 degrees clockwise": ((0, -1), (1, 0)),
    "turn the pictures by 90 degrees counter-clockwise": ((0, 1), (-1, 0)),
    "mirror the pictures left to right, then turn them by 90 degrees clockwise": ((0, -1), (-1, 0)),
    "mirror the pictures left to right, then turn them by 90 degrees counter-clockwise": (
        (0, 1),
        (1, 0),
    ),
}
_AS_IT_IS = ((1, 0), (0, 1))


def size_symptom(code: Code, rig: Rig) -> list[str]:
    """Return a warning if stack and rig have projectors of different sizes."""
    size = (rig.projector.width_px, rig.projector.height_px)
    if size == (code.width_px, code.height_px):
        return []
    return [
        f"the stack's projector is {code.width_px} x {code.height_px} px, that of rig {rig.name} "
        f"{size[0]} x {size[1]}: pixels are matched one to one from the top left, so check that "
        "both use the same display mode"
    ]


def symptoms(
    codes: CodeMap, rig: Rig, depth: DepthMap, residual_px: Float[np.ndarray, "h w"] | None
) -> list[str]:
    """Return warnings about a rig that probably is not the rig of the stack."""
    remedy = better_reading(codes, rig)
    if remedy is not None:
        return [f"the rig does not fit the stack: {remedy}"]
    warnings = []
    away = int((depth.reason == Reason.OUT_OF_RANGE).sum())
    placed = away + int((depth.reason == Reason.DECODED).sum())
    if away > OUT_OF_RANGE * max(placed, 1):
        warnings.append(
            f"{100 * away / placed:.0f} % of the decoded pixels lie outside the rig's working "
            "range: check that it is the rig of this stack, and its near_m and far_m"
        )
    if residual_px is None or not np.isfinite(residual_px).any():
        return warnings
    median_px = float(np.nanmedian(np.abs(residual_px)))
    if median_px > MISPLACED_PX:
        warnings.append(
            f"the epipolar residual's median is {median_px:.3g} px, and less than 1 is usual: the "
            "calibration may be of another rig, the camera may have moved, offset_px may be "
            "wrong, or frames may be exchanged"
        )
    return warnings


def better_reading(codes: CodeMap, rig: Rig) -> str | None:
    """Return a text that names the change that makes the rig fit the stack, or None."""
    both = not (np.isnan(codes.column).all() or np.isnan(codes.row).all())
    y, x = _decoded(codes) if both else _edge(codes, triangulation_axis(rig) == "row")
    if len(y) < LEAST:
        return None if both else _better_by_light(codes, rig)
    size_px = codes.column.shape[::-1]

    def fit(turn, own: Rig) -> float:
        pixel = _moved(np.stack([x, y], axis=-1), turn, size_px, own)
        if pixel is None or (turn[0][0] == 0 and not both):
            return 0.0
        return _fit(pixel, codes.column[y, x], codes.row[y, x], own)

    stated = fit(_AS_IT_IS, rig)
    if stated >= FITS:
        return None
    fits = {what: fit(turn, rig) for what, turn in _TURNS.items()}
    turned_over = replace(rig, T_cam_proj=inverse(rig.T_cam_proj))
    fits["invert R and T of the rig"] = fit(_AS_IT_IS, turned_over)
    best = max(fits, key=lambda what: fits[what])
    if fits[best] < max(FITS, TIMES * stated):
        return None
    where = "places" if both else "places at the edge of the projector's picture"
    return (
        f"{best}: then {100 * fits[best]:.0f} % of the {where} lie where rig {rig.name} puts "
        f"them, and {100 * stated:.0f} % as it is"
    )


def doubts(codes: CodeMap, rig: Rig) -> Iterator[str]:
    """Yield a note if the stack cannot exclude that R and T of the rig are inverted."""
    both = not (np.isnan(codes.column).all() or np.isnan(codes.row).all())
    if both or len(_edge(codes, triangulation_axis(rig) == "row")[0]) >= LEAST:
        return
    stated, inverted = _lit_shares(codes, rig)
    if inverted < POSSIBLE or _surely(stated, inverted):
        return
    yield (
        f"one axis cannot tell whether R and T of rig {rig.name} are inverted: "
        f"{100 * stated:.0f} % of the points lie in the working range and in the projector's light "
        f"as it is, and {100 * inverted:.0f} % if they are inverted. Both axes tell, and so does a "
        "picture with the edge of the projector's light"
    )


def _better_by_light(codes: CodeMap, rig: Rig) -> str | None:
    stated, inverted = _lit_shares(codes, rig)
    if not _surely(stated, inverted):
        return None
    return (
        f"invert R and T of the rig: then {100 * inverted:.0f} % of the points lie in the working "
        f"range and in the projector's light, and {100 * stated:.0f} % as it is"
    )


def _surely(stated: float, inverted: float) -> bool:
    """Return whether the shares of `_lit_shares` prove that R and T are inverted."""
    return inverted >= SURELY_LIT and stated <= 0.5 * inverted


def _lit_shares(codes: CodeMap, rig: Rig) -> tuple[float, float]:
    """Return the share of points in range and lit, for the rig and with R and T inverted.

    A decoded pixel must be lit, so its point must be in the projector's picture.
    """
    if codes.column.shape != (rig.camera.height_px, rig.camera.width_px):
        return 0.0, 0.0
    y, x = _decoded(codes)
    if len(y) < LEAST:
        return 0.0, 0.0
    pixel = np.stack([x, y], axis=-1).astype(np.float64)
    other = 1 if triangulation_axis(rig) == "column" else 0
    size_px = (rig.projector.width_px, rig.projector.height_px)[other]
    shares = []
    for own in (rig, replace(rig, T_cam_proj=inverse(rig.T_cam_proj))):
        point = meet_planes(pixel, codes.column[y, x], codes.row[y, x], own)
        place_px = project(own.projector, transform_points(own.T_proj_cam, point))[:, other]
        lit = (place_px > -NEAR_PX) & (place_px < size_px - 1 + NEAR_PX)
        lit &= (point[:, 2] >= own.near_m) & (point[:, 2] <= own.far_m)
        shares.append(float(lit.mean()))
    return shares[0], shares[1]


def _decoded(codes: CodeMap) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return row and column of evenly sampled decoded pixels."""
    index = np.flatnonzero(codes.reason == Reason.DECODED)
    index = index[:: max(1, len(index) // SAMPLES)]
    y, x = np.unravel_index(index, codes.reason.shape)
    return y, x


def _edge(codes: CodeMap, by_rows: bool) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return row and column of the outermost lit pixels in each picture column, or in each row."""
    lit, decoded = codes.reason != Reason.SHADOW, codes.reason == Reason.DECODED
    if by_rows:
        lit, decoded = lit.T, decoded.T
    last = len(lit) - 1
    ends = [_first(lit, decoded), _first(lit[::-1], decoded[::-1])]
    along = np.concatenate([ends[0][0], last - ends[1][0]])
    across = np.concatenate([ends[0][1], ends[1][1]])
    return (across, along) if by_rows else (along, across)


def _first(
    lit: Bool[np.ndarray, "h w"], decoded: Bool[np.ndarray, "h w"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return row and column of each column's first decoded pixel, if dark pixels precede it."""
    dark, first = lit.argmax(axis=0), decoded.argmax(axis=0)
    good = decoded.any(axis=0) & (dark > RIM_PX) & (first - dark <= RIM_PX)
    return first[good], np.flatnonzero(good)


def _moved(
    pixel: Int[np.ndarray, "n 2"], turn, size_px: tuple[int, int], rig: Rig
) -> Float[np.ndarray, "n 2"] | None:
    """Return the pixels in the turned picture, or None if it does not have the camera's size."""
    camera_px = (rig.camera.width_px, rig.camera.height_px)
    if (size_px if turn[0][0] else size_px[::-1]) != camera_px:
        return None
    middle, to = ((np.array(size) - 1) / 2 for size in (size_px, camera_px))
    return (pixel - middle) @ np.array(turn).T + to


def _fit(pixel, column, row, rig: Rig) -> float:
    """Return the share of pixels in the working range whose other coordinate fits the rig.

    If that axis is not coded, the coordinate must be the projector's first or last.
    """
    point = meet_planes(pixel, column, row, rig)
    place = project(rig.projector, transform_points(rig.T_proj_cam, point))
    other = 1 if triangulation_axis(rig) == "column" else 0
    size_px = (rig.projector.width_px, rig.projector.height_px)[other]
    known = (column, row)[other]
    off_px = place[:, other] - known
    if np.isnan(known).all():
        off_px = np.minimum(abs(place[:, other] + 0.5), abs(place[:, other] - size_px + 0.5))
    in_range = (point[:, 2] >= rig.near_m) & (point[:, 2] <= rig.far_m)
    return float((in_range & (np.abs(off_px) < max(NEAR_PX, NEAR * size_px))).mean())
