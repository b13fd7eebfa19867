"""Errors of decoded depth, and shifts of stripe edges, relative to a converged reference."""

import numpy as np
from jaxtyping import Bool, Float

from graycast.camera.decode import Reason
from graycast.camera.scanner import Scan
from graycast.rendering import Radiance
from graycast.rig.pattern import Code

WRONG_COLUMNS = 1.0  # A column with a larger error is wrong.
WIDE_PX = 8  # Edges are measured on stripes of at least this many projector pixels.
STEP_M = 3e-3  # Neighbours with a larger step in depth belong to two surfaces.
LEAST_CONTRAST = 0.1  # white minus black, as a share of the 99th percentile


def valid(scan: Scan) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels with depth."""
    return scan.depth.reason == Reason.DECODED


def decoding_error(result: Scan, reference: Scan) -> dict[str, float]:
    """Return the errors of a scan; shares are relative to the reference's pixels with depth.

    In `wrong_share` of the pixels, both have depth but the columns differ by more than one. In
    `hole_share`, only the reference has depth, and in `extra_share`, only the scan. `bad_share` is
    the sum of these. The RMS and the median of depth include all pixels where both have depth;
    `depth_rms_right_mm` excludes the wrong pixels.
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

    At an edge, the picture of a bit crosses the middle between white and black; its position is
    interpolated linearly between two pixels. In camera pixels, `edge_bias_px` is the mean shift to
    the right, `edge_growth_px` the mean growth of lit stripes at an edge, and `edge_rms_px` the
    RMS shift. `edge_lost_share` is the share of edges that are not found within a pixel.
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
    """Return the mean contrast (0 to 1) of the finest bit; its stripes are two pixels wide."""
    finest = min((f.bit, k) for k, f in enumerate(code.frames) if f.kind == "gray")[1]
    level = _levels(radiance, code, finest)[on_surface]
    return float(np.nanmean(np.minimum(np.abs(2 * level), 1.0)))


def one_surface(reference: Scan) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the reference's pixels whose right neighbour is on the same surface."""
    depth_m = reference.depth.depth_m
    near = np.zeros(depth_m.shape, dtype=bool)
    near[:, :-1] = np.abs(np.diff(depth_m, axis=1)) < STEP_M  # A comparison with NaN is false.
    return near


def _wide_bits(code: Code) -> list[int]:
    """Return the frames with wide stripes; stripes of the finest Gray bit are two pixels wide."""
    return [
        k
        for k, frame in enumerate(code.frames)
        if frame.kind == "gray" and 2 ** (frame.bit + 1) >= WIDE_PX and frame.axis == "column"
    ]


def _levels(radiance: Radiance, code: Code, number: int) -> Float[np.ndarray, "h w"]:
    """Scale the picture of a bit to -1/2 (black) to 1/2 (white); NaN without enough contrast."""
    kinds = [frame.kind for frame in code.frames]
    white, black = (radiance.pattern[kinds.index(kind)] for kind in ("white", "black"))
    range_ = white - black
    dark = range_ < LEAST_CONTRAST * np.percentile(range_, 99)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(dark, np.nan, (radiance.pattern[number] - black) / range_ - 0.5)


def _edges(
    level: Float[np.ndarray, "h w"], on_surface: Bool[np.ndarray, "h w"], *, rising: bool
) -> Float[np.ndarray, "h w"]:
    """Return the column at which an edge is between a pixel and its right neighbour, or NaN."""
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
    """Return the shift from each wanted edge to the nearest edge within a pixel, or NaN."""
    padded = np.pad(edges, ((0, 0), (1, 1)), constant_values=np.nan)
    w = edges.shape[1]
    shifts = np.stack([padded[:, i : i + w] - wanted for i in range(3)])
    shifts[~(np.abs(shifts) <= 1)] = np.nan
    best = np.argmin(np.where(np.isnan(shifts), np.inf, np.abs(shifts)), axis=0)
    return np.take_along_axis(shifts, best[None], axis=0)[0]


def _rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))) if len(values) else 0.0
