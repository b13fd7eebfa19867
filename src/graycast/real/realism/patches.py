"""Squares cut from depth maps, with features that depend on the sensor and not on the shape.

Second differences along both directions at once, `[1 -2 1] x [1 -2 1]`, are 0 for planes and for
surfaces that bend only along rows or only along columns. On a smooth surface, they therefore show
only noise (Immerkaer, "Fast noise variance estimation", CVIU 64, 1996). Third differences along one
direction show the correlation of the noise in that direction.

Leaves out: colour, and properties that need more than one map.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ...base.robust import robust_sigma
from .scan import DepthScan

SQUARE_PX = 32
STRIDE_PX = 16
_LEAST_VALID = {"smooth": 0.7, "floor": 0.5}
_SMOOTH_M = 2e-3  # largest distance of a smooth square's pixels from a paraboloid
_FLOOR_M = 4e-3  # largest distance of a floor square's pixels from the floor plane
_STRAY = 0.03  # share of a square's pixels that may be farther away
_FLOOR_SHARE = 0.05  # A floor has more than this share of the sampled pixels.
_SAMPLED = 4000  # number of random pixels per map, of which the valid pixels are used
# If a fifth of the pixels is floor, one in 125 random triples is on it, and only some of these
# triples give a plane that is within 4 mm of the floor everywhere.
_DRAWS = 6000
_ELECTORS = 2000  # This many pixels score all planes; then all pixels score the best planes.
_FINALISTS = 20
_LEAST_TRIANGLE_PX2 = 4000.0  # twice the area; smaller triangles do not determine a slope
_TINY_M = 1e-6
_LEAST_PAIRS = 30  # A correlation needs this many pairs of values.

FEATURES = (
    *("noise_log_mm", "tails", "outlying_share", "along_x", "along_y", "common_along_y"),
    *("common_along_x", "missing_share", "holes_1", "holes_2_4", "holes_5_16", "holes_over_16"),
    *("specks", "ragged"),
)
"""Names of what is measured in a square: seven of its noise, and seven of its holes."""

_SIDE = np.linspace(-1, 1, SQUARE_PX)
_X, _Y = np.meshgrid(_SIDE, _SIDE)
# The terms of a paraboloid at each pixel of a square.
PARABOLOID = np.stack([_X**0, _X, _Y, _X * _X, _X * _Y, _Y * _Y], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Squares:
    """Squares of several maps: features, number of the map, and position in the map."""

    feature: Float[np.ndarray, "n features"]
    scan: Int[np.ndarray, " n"]
    corner_px: Int[np.ndarray, "n 2"]  # row, column of the top left pixel
    is_smooth: Bool[np.ndarray, " n"]
    is_floor: Bool[np.ndarray, " n"]

    def at(self, place: str) -> "Squares":
        """Return the squares of a kind: "smooth" or "floor"."""
        return self.only({"smooth": self.is_smooth, "floor": self.is_floor}[place])

    def of_scans(self, number: Sequence[int]) -> "Squares":
        return self.only(np.isin(self.scan, np.array(number)))

    def only(self, keep: Bool[np.ndarray, " n"]) -> "Squares":
        return Squares(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def cut_squares(scans: Sequence[DepthScan], *, step_m: float = 0.0) -> Squares:
    """Cut all squares that show a smooth surface or the floor from some maps.

    Args:
        step_m: step to which depth is rounded first, so that two compared sets have the same
            resolution; 0 does not round.
    """
    depths = [scan.depth_m for scan in scans]
    if step_m > 0:
        depths = [np.round(depth_m / step_m) * step_m for depth_m in depths]
    floor = find_floor(depths)
    parts = [_squares_of(depth_m, number, floor) for number, depth_m in enumerate(depths)]
    names = [f.name for f in fields(Squares)]
    return Squares(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def find_floor(depth_m: Sequence[Float[np.ndarray, "h w"]]) -> Float[np.ndarray, "3"] | None:
    """Find the plane `1/z = g . (x, y, 1)`, with x and y in pixels, that contains most pixels.

    The camera must not move between the maps, because the pixels of all maps are used together. The
    method is RANSAC: the best plane through three random pixels is refined by least squares. The
    result is g, or None if too few pixels are on a plane.
    """
    rng = np.random.default_rng(0)  # The floor hardly depends on which pixels are sampled.
    samples = [_some_pixels(one, rng) for one in depth_m]
    pixel, z_m = (np.concatenate(column) for column in zip(*samples, strict=True))
    if len(z_m) < 3:
        return None
    corners = rng.integers(0, len(z_m), size=(_DRAWS, 3))
    corners = corners[np.abs(np.linalg.det(pixel[corners])) >= _LEAST_TRIANGLE_PX2]
    if not len(corners):
        return None
    planes = np.linalg.solve(pixel[corners], 1 / z_m[corners][..., None])[..., 0]
    electors = rng.integers(0, len(z_m), _ELECTORS)
    votes = [int(_near(pixel[electors], z_m[electors], g).sum()) for g in planes]
    finalists = planes[np.argsort(votes)[-_FINALISTS:]]
    counts = [int(_near(pixel, z_m, g).sum()) for g in finalists]
    if max(counts) <= _FLOOR_SHARE * len(depth_m) * _SAMPLED:
        return None
    plane = finalists[int(np.argmax(counts))]
    for _ in range(3):
        near = _near(pixel, z_m, plane)
        plane = np.linalg.lstsq(pixel[near], 1.0 / z_m[near], rcond=None)[0]
    return plane


def depth_of_floor(
    floor: Float[np.ndarray, "3"], rows: slice, columns: slice
) -> Float[np.ndarray, "h w"]:
    """Return the floor's depth [m] in a rectangle; NaN where the plane is behind the camera."""
    row, column = np.mgrid[rows, columns]
    inverse = floor[0] * column + floor[1] * row + floor[2]
    return 1.0 / np.where(inverse > 0, inverse, np.nan)


def second_difference(z_m: Float[np.ndarray, "*n h w"]) -> Float[np.ndarray, "*n h2 w2"]:
    """Filter by `[1 -2 1] x [1 -2 1] / 6`, so that white noise keeps its standard deviation."""
    along = z_m[..., :-2] - 2 * z_m[..., 1:-1] + z_m[..., 2:]
    return (along[..., :-2, :] - 2 * along[..., 1:-1, :] + along[..., 2:, :]) / 6


def third_difference(z_m: Float[np.ndarray, "*n h w"]) -> Float[np.ndarray, "*n h w3"]:
    """Filter rows by `[1 -3 3 -1] / sqrt(20)`, so that white noise keeps its standard deviation."""
    a, b, c, d = z_m[..., :-3], z_m[..., 1:-2], z_m[..., 2:-1], z_m[..., 3:]
    return (a - 3 * b + 3 * c - d) / np.sqrt(20)


def correlation(
    a: Float[np.ndarray, "*n a b"], b: Float[np.ndarray, "*n a b"]
) -> Float[np.ndarray, "*n"]:
    """Return the correlation of each pair of arrays, clipped at 4 sigma; NaN below 30 values."""
    both = ~np.isnan(a) & ~np.isnan(b)
    enough = both.sum(axis=(-2, -1)) >= _LEAST_PAIRS
    pair = np.where(both, np.stack([a, b]), np.nan)[:, enough]
    sigma = robust_sigma(pair, axis=(0, -2, -1))
    limit = 4 * (sigma + _TINY_M)[:, None, None]
    a, b = np.clip(np.nan_to_num(pair), -limit, limit)  # A pair with a NaN adds 0.
    product, a2, b2 = (one.sum(axis=(-2, -1)) for one in (a * b, a * a, b * b))
    coefficient = np.full(enough.shape, np.nan)
    power = np.sqrt(a2 * b2)
    coefficient[enough] = np.divide(product, power, out=np.zeros_like(power), where=power > 0)
    return coefficient


# --- one square ----------------------------------------------------------------------------------


def _some_pixels(
    depth_m: Float[np.ndarray, "h w"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Return (x, y, 1) and the depth of the valid pixels among `_SAMPLED` random pixels."""
    height, width = depth_m.shape
    y, x = rng.integers(0, height, _SAMPLED), rng.integers(0, width, _SAMPLED)
    known = ~np.isnan(depth_m[y, x])
    y, x = y[known], x[known]
    return np.column_stack([x, y, np.ones(len(x))]).astype(np.float64), depth_m[y, x]


def _near(
    pixel: Float[np.ndarray, "n 3"], z_m: Float[np.ndarray, " n"], g: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, " n"]:
    """Return a mask of the pixels within `_FLOOR_M` of the plane g, where it has positive z."""
    inverse = pixel @ g
    return (inverse > 0) & (np.abs(1.0 / np.maximum(inverse, 1e-9) - z_m) < _FLOOR_M)


def _squares_of(
    depth_m: Float[np.ndarray, "h w"],
    number: int,
    floor: Float[np.ndarray, "3"] | None,
) -> Squares:
    rows, smooth, on_floor, corners = [], [], [], []
    height, width = depth_m.shape
    for y in range(0, height - SQUARE_PX + 1, STRIDE_PX):
        for x in range(0, width - SQUARE_PX + 1, STRIDE_PX):
            place = slice(y, y + SQUARE_PX), slice(x, x + SQUARE_PX)
            z_m = depth_m[place]
            valid = ~np.isnan(z_m)
            share = valid.mean()
            if share < min(_LEAST_VALID.values()):
                continue
            is_smooth = share >= _LEAST_VALID["smooth"] and _holds(
                _paraboloid(z_m, valid), z_m, valid, _SMOOTH_M
            )
            is_floor = floor is not None and _holds(
                depth_of_floor(floor, *place), z_m, valid, _FLOOR_M
            )
            if is_smooth or is_floor:
                rows.append([*_noise(z_m), *_holes(valid)])
                smooth.append(is_smooth)
                on_floor.append(is_floor)
                corners.append((y, x))
    return Squares(
        feature=np.array(rows, dtype=np.float64).reshape(-1, len(FEATURES)),
        scan=np.full(len(rows), number),
        corner_px=np.array(corners, dtype=np.int64).reshape(-1, 2),
        is_smooth=np.array(smooth, dtype=bool),
        is_floor=np.array(on_floor, dtype=bool),
    )


def _holds(
    model_m: Float[np.ndarray, "s s"],
    z_m: Float[np.ndarray, "s s"],
    valid: Bool[np.ndarray, "s s"],
    most_m: float,
) -> bool:
    """Return whether all valid pixels except a share `_STRAY` are within `most_m` of the model."""
    off = np.abs(model_m - z_m)[valid]
    return bool((off <= most_m).mean() >= 1 - _STRAY)


def _paraboloid(
    z_m: Float[np.ndarray, "s s"], valid: Bool[np.ndarray, "s s"]
) -> Float[np.ndarray, "s s"]:
    """Fit a paraboloid by least squares, in three rounds without outliers; return its depth [m]."""
    used, fit = valid, np.full(z_m.shape, np.nan)
    for _ in range(3):
        if used.sum() < 30:
            break
        A, b = PARABOLOID[used], z_m[used]
        fit = PARABOLOID @ np.linalg.solve(A.T @ A + 1e-9 * np.eye(6), A.T @ b)
        off = np.abs(fit - np.where(valid, z_m, np.inf))
        used = valid & (off <= 3 * robust_sigma(off[valid]) + _TINY_M)
    return fit


def _noise(z_m: Float[np.ndarray, "s s"]) -> list[float]:
    mixed, along_x = second_difference(z_m), third_difference(z_m)
    along_y = third_difference(z_m.T).T
    known = mixed[~np.isnan(mixed)]
    if len(known) < 30:
        return [np.nan] * 7
    sigma_m = robust_sigma(known) + _TINY_M
    core = known[np.abs(known) < 4 * sigma_m]
    return [
        float(np.log10(1e3 * sigma_m)),
        float(np.std(core) / sigma_m),
        float((np.abs(known) > 4 * sigma_m).mean()),
        _log_ratio(along_x, sigma_m),
        _log_ratio(along_y, sigma_m),
        float(correlation(along_x[:-1], along_x[1:])),
        float(correlation(along_y[:, :-1], along_y[:, 1:])),
    ]


def _log_ratio(values: Float[np.ndarray, "a b"], sigma_m: float) -> float:
    known = values[~np.isnan(values)]
    return float(np.log((robust_sigma(known) + _TINY_M) / sigma_m)) if len(known) > 30 else np.nan


def _holes(valid: Bool[np.ndarray, "s s"]) -> list[float]:
    label, count = ndimage.label(~valid)
    size = np.bincount(label.ravel(), minlength=count + 1)[1:]
    island, islands = ndimage.label(valid)
    specks = (np.bincount(island.ravel(), minlength=islands + 1)[1:] <= 16).sum()
    edges = (valid[:, 1:] != valid[:, :-1]).sum() + (valid[1:] != valid[:-1]).sum()
    missing = (~valid).sum()
    return [
        float(missing / valid.size),
        float((size == 1).sum()),
        float(((size > 1) & (size <= 4)).sum()),
        float(((size > 4) & (size <= 16)).sum()),
        float((size > 16).sum()),
        float(specks),
        float(edges / np.sqrt(missing)) if missing else 0.0,
    ]
