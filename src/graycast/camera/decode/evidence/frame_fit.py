"""The contrast of a pixel's stripes, and the misfit of its frames to the pattern."""

import math
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt16

from ....base.kernels import kernel
from ....rig.pattern import Axis, Code
from ..separation import NARROW_PX

# A sharp frame says nothing about a position that is nearer to an edge of its stripes than the
# first number [px] plus the second times the projector pixels that a camera pixel covers.
EDGE_PX, EDGE_SHARE, MOST_COVERED = 0.5, 0.75, 6.0


def fit_frames(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    axis: Axis,
    place: Float32[np.ndarray, "h w"],
    step_px: Float32[np.ndarray, "h w"],
    contrast_dn: Float32[np.ndarray, "h w"],
) -> dict[str, Float32[np.ndarray, "h w"]]:
    """Return how well the frames of an axis fit the pattern at the decoded positions.

    Fine frames, whose narrow stripes indirect light blurs first, and coarse frames are fitted
    separately by `a + b share`. Contrasts are `b` over `contrast_dn`; misfits are root mean squares
    of residuals, or the largest one, over `contrast_dn`.

    Args:
        place: positions along the axis [px]; NaN without one.
        step_px: projector pixels that a camera pixel covers.
        contrast_dn: brightest minus darkest frame.
    """
    fitted = np.empty((5, *place.shape), dtype=np.float32)
    _fit(frames, _pattern(code, axis), place, step_px, contrast_dn, fitted)
    names = (
        "coarse contrast",
        "fine contrast",
        "misfit of coarse frames",
        "misfit of fine frames",
        "largest misfit",
    )
    cues = dict(zip(names, fitted, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        cues["fine over coarse contrast"] = fitted[1] / fitted[0]
    return cues


class _Pattern(NamedTuple):
    """The frames of one axis.

    Attributes:
        frame: index of each frame in the stack.
        share: share of white at each projector pixel.
        edge_px: distance of each projector pixel to the nearest edge; infinite in a cosine.
        fine: whether the stripes are fine.
    """

    frame: Int[np.ndarray, " n"]
    share: Float32[np.ndarray, "n size"]
    edge_px: Float32[np.ndarray, "n size"]
    fine: Bool[np.ndarray, " n"]


def _pattern(code: Code, axis: Axis) -> _Pattern:
    own = [(k, frame) for k, frame in enumerate(code.frames) if frame.axis == axis]
    lines = [code.share(frame) for _, frame in own]
    edges = [
        _edge_px(line, sharp=frame.kind != "phase")
        for line, (_, frame) in zip(lines, own, strict=True)
    ]
    return _Pattern(
        frame=np.array([k for k, _ in own]),
        share=np.array(lines, dtype=np.float32),
        edge_px=np.array(edges, dtype=np.float32),
        fine=np.array([code.stripe_px(frame) <= NARROW_PX for _, frame in own]),
    )


def _edge_px(line: Float[np.ndarray, " size"], *, sharp: bool) -> Float32[np.ndarray, " size"]:
    """Return the distance of each pixel's centre to the nearest border where brightness changes."""
    borders = np.flatnonzero(np.diff(line)) + 0.5
    if not sharp or not len(borders):
        return np.full(len(line), np.inf, dtype=np.float32)
    pixel = np.arange(len(line))
    after = np.searchsorted(borders, pixel).clip(0, len(borders) - 1)
    before = (after - 1).clip(0)
    near = np.minimum(np.abs(borders[after] - pixel), np.abs(borders[before] - pixel))
    return near.astype(np.float32)


@kernel(parallel=True, error_model="numpy")
def _fit(stack, pattern, place, step_px, contrast_dn, fitted):
    """Fit `a + b share` to the coarse and to the fine frames of each pixel.

    `fitted` gets `b` of both as shares of the contrast, the root mean squares of their residuals,
    and the largest residual.
    """
    frame, share, edge_px, fine = pattern
    n, size = share.shape
    nothing = np.float32(np.nan)
    for y in numba.prange(place.shape[0]):
        expected, value = np.empty(n, np.float32), np.empty(n, np.float32)
        group = np.empty(n, np.int64)
        for x in range(place.shape[1]):
            u, contrast = place[y, x], contrast_dn[y, x]
            for j in range(5):
                fitted[j, y, x] = nothing
            if np.isnan(u) or contrast <= 0:
                continue
            covered = min(max(step_px[y, x], np.float32(1)), np.float32(MOST_COVERED))
            reach = np.float32(EDGE_PX) + np.float32(EDGE_SHARE) * covered
            middle = min(max(np.int64(math.floor(u + np.float32(0.5))), 0), size - 1)
            whole = np.int64(math.floor(u))
            part = u - np.float32(whole)
            before = min(max(whole, 0), size - 1)
            after = min(max(whole + 1, 0), size - 1)
            for j in range(n):
                value[j] = stack[frame[j], y, x]
                expected[j] = share[j, before] * (1 - part) + share[j, after] * part
                near = edge_px[j, middle] < reach
                group[j] = np.int64(-1) if near else np.int64(fine[j])
            largest = np.float32(0)
            for g in range(2):
                slope, misfit, most = _fit_line(expected, value, group, g)
                if not np.isnan(slope):
                    fitted[g, y, x] = slope / contrast
                    fitted[2 + g, y, x] = misfit / contrast
                    largest = max(largest, most / contrast)
            fitted[4, y, x] = largest


@kernel(error_model="numpy")
def _fit_line(expected, value, group, wanted):
    """Return slope, root mean square and largest residual of a line; NaN for too few frames."""
    n, nothing = 0, np.float32(np.nan)
    mean_e, mean_v = np.float32(0), np.float32(0)
    for j in range(len(group)):
        if group[j] == wanted:
            n += 1
            mean_e += expected[j]
            mean_v += value[j]
    if n < 3:
        return nothing, nothing, nothing
    mean_e /= np.float32(n)
    mean_v /= np.float32(n)
    spread, along = np.float32(0), np.float32(0)
    for j in range(len(group)):
        if group[j] == wanted:
            off = expected[j] - mean_e
            spread += off * off
            along += off * (value[j] - mean_v)
    if spread < np.float32(0.1):
        return nothing, nothing, nothing
    slope = along / spread
    squares, most = np.float32(0), np.float32(0)
    for j in range(len(group)):
        if group[j] == wanted:
            off = abs(value[j] - mean_v - slope * (expected[j] - mean_e))
            squares += off * off
            most = max(most, off)
    return slope, math.sqrt(squares / np.float32(max(n - 2, 1))), most
