"""Estimate of the baseline from the widths of shadows.

A ray of the projector that grazes a near edge at N meets the far surface at F. The camera sees the
pixels between N and F, but they are not lit. With the projector at (b, 0, t) in the camera frame,
projector, N and F are on one line, so x' = x / z of N and F satisfy

    x'_n - x'_f = b (1/z_n - 1/z_f) - t (x'_f / z_n - x'_n / z_f)

For t = 0, the gap is f b (1/z_n - 1/z_f) pixels wide, whatever the rotation of the projector. The
same is true for columns, with y and a projector above or below. Leaves out: a baseline that is
oblique in the picture, because its shadows do not begin and end in the same row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.optimize import least_squares

from .missing import small_islands
from .realism_record import Baseline
from .scan import DepthScan

_LEAST_GAP_PX = 4
_RIM_PX = 3  # A gap needs this many valid pixels of one surface on each side.
_SMOOTH = 1 / 3  # Neighbours on one surface differ by less than this share of a jump.
_AGREE = 0.2  # Estimates that differ by at most this share agree.
_ROUNDS = 3
_LEAST_ROWS = 5  # An edge must appear in at least this many rows.
_LEAST_EDGES = 5
_LEAST_AGREEING = 0.25
_EDGE_PX = 2.0  # standard deviation of the error of a shadow's width, per edge
_EATEN_PX = 2.0  # prior standard deviation of the pixels that filters remove at the rims
_FORWARD = 0.5  # relative prior standard deviation of t (see `estimate_baseline`)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gaps:
    """Shadows along the rows (or columns) of a map: x / z (or y / z) and depth of both rims."""

    near: Float[np.ndarray, " n"]  # x / z or y / z, half a pixel outside the last valid pixel
    far: Float[np.ndarray, " n"]
    near_m: Float[np.ndarray, " n"]
    far_m: Float[np.ndarray, " n"]
    focal_px: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]  # 1 / (number of gaps at the same edge)

    @property
    def step(self) -> Float[np.ndarray, " n"]:
        """Difference of inverse depths 1/z_near - 1/z_far [1/m]."""
        return 1 / self.near_m - 1 / self.far_m

    @property
    def baseline_m(self) -> Float[np.ndarray, " n"]:
        """Baseline b from each gap if t = 0; negative if the near rim is on the left (or above)."""
        return (self.near - self.far) / self.step

    def shadow(self, across_m: float, forward_m: float) -> Float[np.ndarray, " n"]:
        """Return the predicted x'_n - x'_f for a projector at (across, 0, forward)."""
        return across_m * self.step - forward_m * (self.far / self.near_m - self.near / self.far_m)

    def only(self, which: Bool[np.ndarray, " n"]) -> "Gaps":
        return Gaps(**{f.name: getattr(self, f.name)[which] for f in fields(self)})


def find_gaps(scan: DepthScan) -> tuple[Gaps, Gaps]:
    """Return the clean shadows along the rows and along the columns.

    A gap is clean if it is at least 4 pixels wide, the three pixels on each side are on one
    surface, these surfaces are a jump apart, and the near rim continues over five rows. Specks of
    depth in the gap are ignored.
    """
    depth_m = np.where(small_islands(scan.valid) > 0, np.nan, scan.depth_m)
    K = scan.K
    rows = _along_rows(depth_m, scan.jump_share, K[0, 0], K[0, 2])
    return rows, _along_rows(depth_m.T, scan.jump_share, K[1, 1], K[1, 2])


def estimate_baseline(
    along_rows: Sequence[Gaps], along_columns: Sequence[Gaps], known_m: float | None
) -> Baseline | None:
    """Estimate the baseline on which most gaps agree, along rows or columns; None if few agree.

    The most frequent estimate from single gaps gives the side and a start value. Then b, t and the
    number of pixels that filters remove at the rims are fitted robustly to the gaps that agree. All
    gaps at one edge count as one, so that a long wall does not dominate. Gaps determine t only
    weakly, so it has a normal prior with the mean b^2 / 2z, the value if camera and projector are
    turned equally to a point at the median distance z. Its standard deviation is half of the mean,
    so that t = 0 is two standard deviations away.
    """
    both = (
        _agreed(_joined(along_rows), ("left", "right"), known_m),
        _agreed(_joined(along_columns), ("above", "below"), known_m),
    )
    sure = [baseline for baseline in both if baseline is not None]
    return max(sure, key=lambda f: f.edges * f.agreeing**2, default=None)


def _agreed(gaps: Gaps, sides: tuple[str, str], known_m: float | None) -> Baseline | None:
    estimate_m, edges = gaps.baseline_m, gaps.weight.sum()
    if edges < _LEAST_EDGES:
        return None
    mode_m = _mode(estimate_m, gaps.weight)
    agree = np.abs(estimate_m / mode_m - 1) <= _AGREE
    for _ in range(_ROUNDS):
        agreeing = gaps.weight[agree].sum()
        if agreeing < max(_LEAST_EDGES, _LEAST_AGREEING * edges):
            return None
        across_m, forward_m, eaten_px, error_m = _solve(gaps.only(agree), mode_m)
        eaten = np.sign(mode_m) * eaten_px / gaps.focal_px
        shadow = gaps.shadow(across_m, forward_m) + eaten
        agree = np.abs((gaps.near - gaps.far) / shadow - 1) <= _AGREE
    return Baseline(
        side=sides[int(mode_m > 0)],
        gaps=len(estimate_m),
        edges=float(edges),
        agreeing=float(agreeing / edges),
        plain_m=abs(mode_m),
        baseline_m=float(np.hypot(across_m, forward_m)),
        error_m=error_m,
        across_m=abs(across_m),
        forward_m=forward_m,
        eaten_px=eaten_px,
        known_m=known_m,
    )


def _mode(estimate_m: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    """Return the estimate with the most others within 10 %; the middle one if several have it."""
    best, most = 0.0, 0.0
    for sign in (-1, 1):
        order = np.argsort(sign * estimate_m)
        order = order[sign * estimate_m[order] > 0]
        log = np.log(sign * estimate_m[order])
        total = np.concatenate([[0.0], np.cumsum(weight[order])])
        count = total[np.searchsorted(log, log + 0.1)] - total[np.searchsorted(log, log - 0.1)]
        if len(log) and count.max() > most:
            most = count.max()
            equal = log[count >= most - 1e-9]
            best = sign * np.exp(equal[len(equal) // 2])
    return float(best)


def _solve(gaps: Gaps, start_m: float) -> tuple[float, float, float, float]:
    """Fit b and t [m] and the excess width of gaps [px]; return also the baseline's error [m]."""
    side, share = np.sign(start_m), np.sqrt(gaps.weight) / _EDGE_PX
    middle_m = float(np.median((gaps.near_m + gaps.far_m) / 2))
    usual_m = start_m**2 / (2 * middle_m)

    def misfit(p: Float[np.ndarray, "3"]) -> Float[np.ndarray, " m"]:
        b, t, eaten_px = p
        rest_px = gaps.focal_px * (gaps.near - gaps.far - gaps.shadow(b, t)) - side * eaten_px
        prior = [(t / usual_m - 1) / _FORWARD, eaten_px / _EATEN_PX]
        return np.concatenate([_softened(share * rest_px), prior])

    start = [start_m, usual_m, 0.0]
    solution = least_squares(misfit, start, x_scale=[0.1, 0.1, 1.0])
    b, t, eaten_px = (float(value) for value in solution.x)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac)
    along = np.array([b, t]) / np.hypot(b, t)
    return b, t, eaten_px, float(np.sqrt(along @ covariance[:2, :2] @ along))


def _softened(rest: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return residuals whose squares grow like |r| for large r: sqrt(2 (sqrt(1 + r^2) - 1))."""
    return rest * np.sqrt(2 / (1 + np.sqrt(1 + rest**2)))


def _along_rows(
    depth_m: Float[np.ndarray, "h w"], jump_share: float, focal_px: float, centre_px: float
) -> Gaps:
    row, column = np.nonzero(~np.isnan(depth_m))
    one_row = row[1:] == row[:-1]
    gap = np.flatnonzero(one_row & (np.diff(column) > _LEAST_GAP_PX))
    y, left, right = row[gap], column[gap], column[gap + 1]
    smooth = _smooth_rims(depth_m, y, left, right, jump_share)
    y, left, right = y[smooth], left[smooth], right[smooth]
    z_left, z_right = depth_m[y, left].astype(float), depth_m[y, right].astype(float)
    apart = np.abs(z_left - z_right) > jump_share * np.minimum(z_left, z_right)
    y, left, right, z_left, z_right = (v[apart] for v in (y, left, right, z_left, z_right))
    left_near = z_left < z_right
    rows = _rows_of_edges(depth_m.shape, y, np.where(left_near, left, right))
    # The lit surface ends half a pixel beyond the last lit centre, on average.
    a = (left + 0.5 - centre_px) / focal_px
    b = (right - 0.5 - centre_px) / focal_px
    gaps = Gaps(
        near=np.where(left_near, a, b),
        far=np.where(left_near, b, a),
        near_m=np.minimum(z_left, z_right),
        far_m=np.maximum(z_left, z_right),
        focal_px=np.full(len(y), focal_px),
        weight=1.0 / rows,
    )
    return gaps.only(rows >= _LEAST_ROWS)


def _rows_of_edges(
    shape: tuple[int, ...], y: Int[np.ndarray, " n"], x: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Count, for each gap, the gaps whose near rims belong to the same edge.

    Noise may divide a rim into pieces. So an edge may shift by 3 px from row to row and have gaps
    of 10 rows.
    """
    rim = np.zeros(shape, dtype=bool)
    rim[y, x] = True
    wide = ndimage.binary_dilation(rim, structure=np.ones((11, 3), dtype=bool))
    label, _ = ndimage.label(wide, structure=np.ones((3, 3), dtype=int))
    return np.bincount(label[y, x])[label[y, x]] if len(y) else np.zeros(0, dtype=np.int64)


def _smooth_rims(
    depth_m: Float[np.ndarray, "h w"],
    y: Int[np.ndarray, " n"],
    left: Int[np.ndarray, " n"],
    right: Int[np.ndarray, " n"],
    jump_share: float,
) -> Bool[np.ndarray, " n"]:
    """Return a mask of the gaps with one smooth surface on each side, not the image's border."""
    last = depth_m.shape[1] - 1
    smooth = (left >= _RIM_PX - 1) & (right <= last - (_RIM_PX - 1))
    for rim, away in ((left, -1), (right, 1)):
        place = (rim + away * np.arange(_RIM_PX)[:, None]).clip(0, last)
        z = depth_m[y, place]
        with np.errstate(invalid="ignore"):  # Comparisons with NaN are false.
            smooth &= (np.abs(np.diff(z, axis=0)) < _SMOOTH * jump_share * z[0]).all(axis=0)
    return smooth


def _joined(gaps: Sequence[Gaps]) -> Gaps:
    names = [f.name for f in fields(Gaps)]
    return Gaps(**{name: np.concatenate([getattr(g, name) for g in gaps]) for name in names})
