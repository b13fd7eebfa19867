"""Errors of decoded depth against a converged reference, and of the edges of stripes."""

import numpy as np
from jaxtyping import Bool, Float

from graycast.camera.decode import Reason
from graycast.camera.scanner import Scan
from graycast.rendering import Radiance
from graycast.rig.pattern import Code

WRONG_COLUMNS = 1.0  # a column with a larger error is wrong
WIDE_PX = 8  # stripes of at least this many projector pixels have edges that can be located
STEP_M = 3e-3  # neighbours with a larger step in depth belong to two surfaces
LEAST_CONTRAST = 0.1  # white minus black, as a share of the 99th percentile


def valid(scan: Scan) -> Bool[np.ndarray, "h w"]:
    """Return the pixels with depth."""
    return scan.depth.reason == Reason.DECODED


def decoding_error(result: Scan, reference: Scan) -> dict[str, float]:
    """Return the error of a scan; shares are relative to the reference's pixels with depth.

    `wrong_share`: both have depth, the columns differ by more than one. `hole_share`: the depth is
    lost. `extra_share`: there is depth where the reference has none. `bad_share` is their sum.
    The root mean square and the median of depth include all pixels with both depths;
    `depth_rms_right_mm` excludes the wrong ones.
    """
    known, expected = valid(result), valid(reference)
    both = known & expected
    off_px = np.abs(result.codes.column - reference.codes.column)[both]
    off_mm = 1e3 * np.abs(result.depth.depth_m - reference.depth.depth_m)[both]
    wrong = off_px > WRONG_COLUMNS
    count = max(int(expected.sum()), 1)
    shares = {
        "wrong_share": float(wrong.sum() / count),
        "hole_share": float((expected & ~known).sum() / count),
        "extra_share": float((known & ~expected).sum() / count),
    }
    return {
        "bad_share": sum(shares.values()),
        **shares,
        "depth_rmse_mm": _rms(off_mm),
        "depth_rms_right_mm": _rms(off_mm[~wrong]),
        "depth_median_mm": float(np.median(off_mm)) if len(off_mm) else 0.0,
    }


def edge_shifts(
    radiance: Radiance, reference: Radiance, code: Code, on_surface: Bool[np.ndarray, "h w"]
) -> dict[str, float]:
    """Return the shifts of the edges of wide stripes against the reference, along camera rows.

    At an edge, a bit's picture crosses the middle between white and black, linear between two
    pixels. `edge_bias_px` is the mean shift towards the right, `edge_growth_px` the mean by which
    lit stripes grow at an edge, `edge_rms_px` the scatter [camera px]; edges that are not found
    within a pixel of their place are `edge_lost_share`.
    """
    along, outward, lost, count = [], [], 0, 0
    for number in _wide_bits(code):
        levels, expected = (_levels(light, code, number) for light in (radiance, reference))
        for rising in (True, False):
            wanted = _edges(expected, on_surface, rising=rising)
            shift = _nearest(_edges(levels, on_surface, rising=rising), wanted)
            known = np.isfinite(shift)
            count += int(np.isfinite(wanted).sum())
            lost += int((np.isfinite(wanted) & ~known).sum())
            along.append(shift[known])
            outward.append(-shift[known] if rising else shift[known])
    shift_px, growth_px = np.concatenate(along), np.concatenate(outward)
    if not len(shift_px):
        return {}
    return {
        "edge_bias_px": float(shift_px.mean()),
        "edge_growth_px": float(growth_px.mean()),
        "edge_rms_px": _rms(shift_px),
        "edge_lost_share": lost / count,
    }


def fine_contrast(radiance: Radiance, code: Code, on_surface: Bool[np.ndarray, "h w"]) -> float:
    """Return the mean contrast (0 to 1) of the finest bit, whose stripes are two pixels wide."""
    finest = min((f.bit, k) for k, f in enumerate(code.frames) if f.kind == "gray")[1]
    level = _levels(radiance, code, finest)[on_surface]
    return float(np.nanmean(np.minimum(np.abs(2 * level), 1.0)))


def one_surface(reference: Scan) -> Bool[np.ndarray, "h w"]:
    """Return the pixels of the reference whose right neighbour has nearly the same depth."""
    depth_m = reference.depth.depth_m
    near = np.zeros(depth_m.shape, dtype=bool)
    near[:, :-1] = np.abs(np.diff(depth_m, axis=1)) < STEP_M  # a comparison with NaN is false
    return near


def _wide_bits(code: Code) -> list[int]:
    """Return the frames of wide stripes; those of the finest Gray bit are two values wide."""
    return [
        k
        for k, frame in enumerate(code.frames)
        if frame.kind == "gray" and 2 ** (frame.bit + 1) >= WIDE_PX and frame.axis == "column"
    ]


def _levels(radiance: Radiance, code: Code, number: int) -> Float[np.ndarray, "h w"]:
    """Scale a bit's picture to -1/2 (black) to 1/2 (white); NaN where both are nearly equal."""
    kinds = [frame.kind for frame in code.frames]
    white, black = (radiance.pattern[kinds.index(kind)] for kind in ("white", "black"))
    range_ = white - black
    dark = range_ < LEAST_CONTRAST * np.percentile(range_, 99)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(dark, np.nan, (radiance.pattern[number] - black) / range_ - 0.5)


def _edges(
    level: Float[np.ndarray, "h w"], on_surface: Bool[np.ndarray, "h w"], *, rising: bool
) -> Float[np.ndarray, "h w"]:
    """Return the column of the crossing between each pixel and its right neighbour, or NaN."""
    left, right = level[:, :-1], level[:, 1:]
    crosses = (left < 0) & (right >= 0) if rising else (left >= 0) & (right < 0)
    place = np.full(level.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        place[:, :-1] = np.arange(level.shape[1] - 1) + left / (left - right)
    place[:, :-1][~(crosses & on_surface[:, :-1])] = np.nan
    return place


def _nearest(
    edges: Float[np.ndarray, "h w"], wanted: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return the shift to the nearest edge within a pixel of each wanted place, or NaN."""
    padded = np.pad(edges, ((0, 0), (1, 1)), constant_values=np.nan)
    w = edges.shape[1]
    shifts = np.stack([padded[:, i : i + w] - wanted for i in range(3)])
    shifts[~(np.abs(shifts) <= 1)] = np.nan
    best = np.argmin(np.where(np.isnan(shifts), np.inf, np.abs(shifts)), axis=0)
    return np.take_along_axis(shifts, best[None], axis=0)[0]


def _rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))) if len(values) else 0.0
