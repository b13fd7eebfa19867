"""Fine noise from second differences within a map, and from differences of two maps.

The second difference along both directions at once is 0 for planes and for surfaces that bend only
along rows or only along columns. So tiles of 8 x 8 pixels can be used on almost all smooth
surfaces, even on most patches that `noise.py` excludes as bent. Differences of neighbours remove
noise that the scanner's smoothing has correlated. The result is the noise of the finest scale,
scaled so that white noise keeps its standard deviation. In the difference of two maps of the same
surface, the shape cancels, and only noise that is not common to both maps remains.

Source: Immerkaer, "Fast noise variance estimation", CVIU 64 (1996), for the operator.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import binom, chi2

from ...base.robust import robust_sigma
from .patches import second_difference
from .realism_record import BinRecord, Fine, Pairs
from .scan import DepthScan, tiles

TILE_PX = 8
LEAST_TILES = 20  # Bins are compared only if they have this many tiles.
BRIGHTNESS_EDGES = np.array([0, *(2.0**-k for k in range(8, 0, -1)), np.nextafter(1.0, 2.0)])
INCIDENCE_EDGES_DEG = np.arange(0.0, 90.0, 10.0)
_OUTLIER = 6.0  # A difference is an outlier beyond this many standard deviations of its tile.
_MOST_OUTLIERS = 0.05  # A tile with a larger share of outliers is an edge.
_LEAST_DIFFERENCES = 20  # A tile has 36 differences.
_FACING_DEG = 45.0  # Noise by brightness uses tiles up to this angle of incidence.
_SAME_M = 3e-3  # Two maps that differ by less show the same surface.
_PERCENTILES = (5, 25, 50, 75, 95)
_LAGS = (1, 2, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class FineNoise:
    """Noise, incidence and brightness of the smooth tiles of one map."""

    tiles: int  # tiles with enough pixels
    variance_m2: Float[np.ndarray, " n"]
    incidence_rad: Float[np.ndarray, " n"]
    brightness: Float[np.ndarray, " n"]  # NaN without a picture


@dataclass(frozen=True, slots=True, kw_only=True)
class PairNoise:
    """Noise [m] and its correlation at lags of 1, 2 and 3 pixels, from two maps of one surface."""

    pixels: int
    sigma_m: float
    along_rows: tuple[float, ...]
    along_columns: tuple[float, ...]


def measure_fine(scan: DepthScan) -> FineNoise:
    """Measure the noise variance, incidence and brightness of every smooth tile."""
    z_m = tiles(scan.depth_m.astype(np.float64), TILE_PX)
    mixed = second_difference(z_m).reshape(len(z_m), (TILE_PX - 2) ** 2)
    known = ~np.isnan(mixed)
    number = np.flatnonzero(known.sum(axis=1) >= _LEAST_DIFFERENCES)
    mixed, known, count = mixed[number], known[number], len(number)
    size = np.where(known, np.abs(mixed), np.nan)
    spread = robust_sigma(size, axis=1, keepdims=True) if count else size[:, :1]
    with np.errstate(invalid="ignore"):
        inner = known & (size <= _OUTLIER * spread)
    out = 1 - inner.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    smooth = (out <= _MOST_OUTLIERS) & (spread[:, 0] > 0)
    number, inner, mixed = number[smooth], inner[smooth], mixed[smooth]
    variance = np.where(inner, mixed**2, 0.0).sum(axis=1) / np.maximum(inner.sum(axis=1), 1)
    brightness = np.full(len(number), np.nan)
    if scan.gray is not None:
        brightness = tiles(scan.gray, TILE_PX).mean(axis=(1, 2), dtype=np.float64)[number]
    return FineNoise(
        tiles=count,
        variance_m2=variance,
        incidence_rad=_incidence_rad(scan, z_m[number], number),
        brightness=brightness,
    )


def summarise_fine(maps: Sequence[FineNoise]) -> Fine:
    """Summarise the tiles of all maps."""
    variance = np.concatenate([m.variance_m2 for m in maps])
    incidence_deg = np.degrees(np.concatenate([m.incidence_rad for m in maps]))
    brightness = np.concatenate([m.brightness for m in maps])
    all_tiles = sum(m.tiles for m in maps)
    lit = (incidence_deg < _FACING_DEG) & ~np.isnan(brightness)
    by_brightness = _bins(brightness[lit], variance[lit], BRIGHTNESS_EDGES)
    by_incidence = _bins(incidence_deg, variance, INCIDENCE_EDGES_DEG)
    dark = [b.value for b in by_brightness if b.value and b.count >= LEAST_TILES]
    facing, steep = _median_m(variance[incidence_deg < 10]), _median_m(
        variance[(incidence_deg >= 40) & (incidence_deg < 50)])  # fmt: skip
    sigma_m = np.sqrt(variance / median_over_mean())
    return Fine(
        tile_px=TILE_PX,
        tiles=len(variance),
        rough=1 - len(variance) / all_tiles if all_tiles else None,
        percentiles_m=np.percentile(sigma_m, _PERCENTILES).tolist() if len(sigma_m) else None,
        by_brightness=by_brightness if lit.any() else [],
        by_incidence=by_incidence,
        dark_to_bright=dark[0] / dark[-1] if len(dark) > 1 else None,
        steep_to_facing=steep / facing if facing and steep else None,
    )


def measure_pair(first: DepthScan, second: DepthScan) -> PairNoise | None:
    """Measure the noise where two maps show the same surface; return None if they share too little.

    Shape and systematic errors that both maps share cancel in the difference of the maps. The
    standard deviation of the difference is sqrt(2) times that of one map.
    """
    same_camera = first.depth_m.shape == second.depth_m.shape and np.allclose(first.K, second.K)
    if not same_camera:
        return None
    difference = first.depth_m - second.depth_m
    with np.errstate(invalid="ignore"):
        difference = np.where(np.abs(difference) < _SAME_M, difference, np.nan)
    rest = _without_drift(difference)
    known = rest[~np.isnan(rest)]
    if len(known) < 1000:
        return None
    sigma_m = robust_sigma(known)
    rest = np.where(np.abs(rest) <= 4 * sigma_m, rest, np.nan)
    return PairNoise(
        pixels=len(known),
        sigma_m=sigma_m / np.sqrt(2),
        along_rows=tuple(_lag(rest, lag) for lag in _LAGS),
        along_columns=tuple(_lag(rest.T, lag) for lag in _LAGS),
    )


def summarise_pairs(pairs: Sequence[PairNoise]) -> Pairs:
    """Return means over the pairs, weighted by the number of shared pixels."""
    if not pairs:
        return Pairs(pairs=0, pixels=0, sigma_m=None, along_rows=None, along_columns=None)
    weight = np.array([p.pixels for p in pairs], dtype=np.float64)

    def mean(values: Sequence[float | tuple[float, ...]]) -> Any:
        return np.average(np.array(values), axis=0, weights=weight)

    return Pairs(
        pairs=len(pairs),
        pixels=int(weight.sum()),
        sigma_m=float(np.sqrt(mean([p.sigma_m**2 for p in pairs]))),
        along_rows=mean([p.along_rows for p in pairs]).tolist(),
        along_columns=mean([p.along_columns for p in pairs]).tolist(),
    )


@cache
def median_over_mean() -> float:
    """Return the ratio of median to mean of a tile's mean squared difference in white noise.

    Neighbouring differences share pixels, so the sum of their squares is not chi-square
    distributed. It is approximated by a shifted chi-square of equal mean, variance and skewness.

    Source: Liu, Tang & Zhang, Computational Statistics & Data Analysis 53 (2009), central case.
    """
    one = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0  # autocorrelation of [1 -2 1]
    step = np.arange(TILE_PX - 2)
    apart = np.abs(step[:, None] - step)
    along = np.where(apart <= 2, one[np.minimum(apart, 2) + 2], 0.0)
    weight = np.linalg.eigvalsh(np.kron(along, along))
    mean, square, cube = (float((weight**k).sum()) for k in (1, 2, 3))
    freedom = square**3 / cube**2
    median = mean + np.sqrt(square / freedom) * (chi2.ppf(0.5, freedom) - freedom)
    return float(median / mean)


# --- tiles ---------------------------------------------------------------------------------------


def _incidence_rad(
    scan: DepthScan, z_m: Float[np.ndarray, "n t t"], number: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the angle between each tile's normal and the ray through its centre.

    `number` counts tiles row by row. If `1/z = g . (x, y, 1)`, with x and y in pixels, the normal
    is parallel to K^T g; the ray is K^-1 (x, y, 1).
    """
    t = np.arange(TILE_PX) - (TILE_PX - 1) / 2
    x, y = (c.ravel() for c in np.meshgrid(t, t))
    inverse = 1.0 / z_m.reshape(len(z_m), TILE_PX**2)
    used = ~np.isnan(inverse)
    basis = np.column_stack([x, y, np.ones(len(x))])
    squares = np.einsum("np,pi,pj->nij", used, basis, basis) + 1e-9 * np.eye(3)
    right = np.einsum("np,pi->ni", np.where(used, inverse, 0.0), basis)
    slope = np.linalg.solve(squares, right[..., None])[..., 0]
    row, column = np.divmod(number, max(scan.depth_m.shape[1] // TILE_PX, 1))
    centre = np.column_stack([column, row]) * float(TILE_PX) + (TILE_PX - 1) / 2
    g = np.column_stack([slope[:, :2], slope[:, 2] - (slope[:, :2] * centre).sum(axis=1)])
    normal = g @ scan.K
    ray = np.column_stack([centre, np.ones(len(centre))]) @ np.linalg.inv(scan.K).T
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1)
    return np.arccos((np.abs((normal * ray).sum(axis=1)) / length).clip(max=1.0))


# --- bins ----------------------------------------------------------------------------------------


def _bins(
    of: Float[np.ndarray, " n"], variance: Float[np.ndarray, " n"], edges: Float[np.ndarray, " e"]
) -> list[BinRecord]:
    place = np.digitize(of, edges) - 1
    groups = [variance[place == i] for i in range(len(edges) - 1)]
    return [
        BinRecord(
            low=low,
            high=high,
            count=len(group),
            value=_median_m(group),
            interval=_interval_m(group),
        )
        for (low, high), group in zip(pairwise(edges), groups, strict=True)
    ]


def _median_m(variance: Float[np.ndarray, " n"]) -> float | None:
    return float(np.sqrt(np.median(variance) / median_over_mean())) if len(variance) else None


def _interval_m(variance: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """Return the median's 95 % confidence interval (order statistics); None below 6 values."""
    n = len(variance)
    if n < 6:
        return None
    low = int(binom.ppf(0.025, n, 0.5))
    ordered = np.sqrt(np.sort(variance)[[max(low - 1, 0), min(n - low, n - 1)]])
    ordered = ordered / np.sqrt(median_over_mean())
    return float(ordered[0]), float(ordered[1])


# --- pairs ---------------------------------------------------------------------------------------


def _without_drift(difference: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Subtract the median of each block of 32 x 32 pixels, because slow drift is not noise."""
    rest = np.full(difference.shape, np.nan)
    for y in range(0, difference.shape[0], 32):
        for x in range(0, difference.shape[1], 32):
            block = difference[y : y + 32, x : x + 32]
            known = ~np.isnan(block)
            if known.sum() >= 200:
                rest[y : y + 32, x : x + 32] = block - np.median(block[known])
    return rest


def _lag(rest: Float[np.ndarray, "h w"], lag: int) -> float:
    """Return the correlation of pixels that are `lag` pixels apart along the rows."""
    a, b = rest[:, :-lag], rest[:, lag:]
    both = ~np.isnan(a) & ~np.isnan(b)
    power = np.sqrt((a[both] ** 2).mean() * (b[both] ** 2).mean()) if both.any() else 0.0
    return float((a[both] * b[both]).mean() / power) if power > 0 else 0.0
