"""Depth steps between two surfaces, and flying pixels in the air between the surfaces."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .scan import DepthScan

_Values = Float[np.ndarray, "..."]
_Mask = Bool[np.ndarray, "..."]

_REACH_PX = 8
_MARGIN = 0.25  # least distance of a flying pixel from both surfaces, as a share of `jump_share`


@dataclass(frozen=True, slots=True, kw_only=True)
class StepCounts:
    """Counts of jumps, pixels at steps and flying pixels in one map."""

    right_farther: int
    left_farther: int
    below_farther: int
    above_farther: int
    step_pixels: int
    flying: int


def count_steps(scan: DepthScan) -> StepCounts:
    """Count jumps between valid pixels by direction, pixels at steps, and flying pixels.

    Two pixels on each side of a possible step, along a row or a column, define a line in 1/z, which
    is exact for planes of any slope. If the two lines, extended to the step, differ by more than
    `jump_share`, there is a jump. It has no missing pixel but may have one flying pixel.

    A pixel is at a step if the lines through the second and third pixel on each side differ at it.
    These seven pixels may have one gap, so the rims of a shadow are a step. The pixel is flying if
    it is between both lines, at least a quarter of a jump from both and from its two neighbours.
    A surface one pixel wide counts as flying; some flying pixels in wider groups do not.
    """
    inverse = 1.0 / scan.depth_m.astype(np.float64)
    right, left = _jumps(inverse, scan.jump_share)
    below, above = _jumps(inverse.T, scan.jump_share)
    at_row, flying_row = flying_pixels(inverse, scan.jump_share)
    at_column, flying_column = flying_pixels(inverse.T, scan.jump_share)
    return StepCounts(
        right_farther=right,
        left_farther=left,
        below_farther=below,
        above_farther=above,
        step_pixels=int((at_row | at_column.T).sum()),
        flying=int((flying_row | flying_column.T).sum()),
    )


def _jumps(inverse: Float[np.ndarray, "h w"], share: float) -> tuple[int, int]:
    """Count the jumps along rows of 1/z whose far side is on the right, and on the left."""
    right = left = 0
    for between in (0, 1):  # number of flying pixels in the jump
        length = 4 + between
        if inverse.shape[1] < length:
            continue
        window = np.lib.stride_tricks.sliding_window_view(inverse, length, axis=1)
        a, b, c, d = (window[..., i] for i in (0, 1, -2, -1))
        reach = (1 + between) / 2
        ends = b + reach * (b - a), c - reach * (d - c)
        with np.errstate(invalid="ignore"):  # Comparisons with NaN are false.
            jump = _smooth(a, b, share) & _smooth(c, d, share) & _apart(*ends, share)
            jump &= _apart(b, c, share)
            if between:
                jump &= _between(window[..., 2], *ends, share)
        right += int((jump & (c < b)).sum())
        left += int((jump & (c > b)).sum())
    return right, left


def flying_pixels(
    inverse: Float[np.ndarray, "h w"], share: float
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return masks of the pixels at a step of 1/z along their row, and of the flying pixels."""
    row, column = np.nonzero(~np.isnan(inverse))
    at_image = np.zeros(inverse.shape, dtype=bool)
    flying_image = np.zeros(inverse.shape, dtype=bool)
    if len(row) < 7:
        return at_image, flying_image
    # The test is made for the middle of each seven successive valid pixels in one row.
    windows = np.lib.stride_tricks.sliding_window_view
    one_row = row[:-6] == row[6:]
    a, b, before, middle, after, c, d = windows(inverse[row, column], 7)[one_row].T
    place = windows(column, 7)[one_row]
    # Slopes are noisy, so they are not extrapolated across wide gaps.
    reach_left = np.minimum(place[:, 3] - place[:, 1], _REACH_PX)
    reach_right = np.minimum(place[:, 5] - place[:, 3], _REACH_PX)
    ends = (
        b + reach_left * (b - a) / (place[:, 1] - place[:, 0]),
        c - reach_right * (d - c) / (place[:, 6] - place[:, 5]),
    )
    # A single gap may be a shadow, but several gaps are holes in a surface.
    at = (np.diff(place, axis=1) > 1).sum(axis=1) <= 1
    at &= _smooth(a, b, share) & _smooth(c, d, share)
    at &= _apart(*ends, share) & _apart(b, c, share)
    alone = _off(middle, before, share) & _off(middle, after, share)
    flying = at & alone & _between(middle, *ends, share)
    here = row[3:-3][one_row], column[3:-3][one_row]
    at_image[here], flying_image[here] = at, flying
    return at_image, flying_image


# A relative difference of 1/z is about equal to the relative difference of z.


def _smooth(a: _Values, b: _Values, share: float) -> _Mask:
    return np.abs(a - b) < share * np.maximum(a, b)


def _apart(a: _Values, b: _Values, share: float) -> _Mask:
    return np.abs(a - b) > share * np.maximum(a, b)


def _off(a: _Values, b: _Values, share: float) -> _Mask:
    return np.abs(a - b) > _MARGIN * share * np.maximum(a, b)


def _between(middle: _Values, a: _Values, b: _Values, share: float) -> _Mask:
    inside = (middle > np.minimum(a, b)) & (middle < np.maximum(a, b))
    return inside & _off(middle, a, share) & _off(middle, b, share)
