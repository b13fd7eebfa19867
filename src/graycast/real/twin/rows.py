"""The statistics that a twin is to share with the real scans: one row each, a number per scan.

The twin scans the scenes of the real scans, so all of them are the sensor's doing.
"""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...base.robust import robust_sigma
from ..realism import DepthScan
from ..realism.depth_steps import count_steps
from ..realism.fine import measure_fine, median_over_mean
from ..realism.missing import count_missing
from ..realism.patches import (
    SQUARE_PX,
    correlation,
    second_difference,
    third_difference,
)

Places = Mapping[str, Bool[np.ndarray, "h w"]]  # where missing depth is counted, by `PLACES`
_SIGMAS = 2.0  # within so many standard deviations of the real scans' mean a row is met
_LEAST_SPREAD = 0.05  # as a share of the mean: three scans do not tell a spread well
_LEAST_KNOWN = 0.7  # of a square's differences, to tell tails
_LEAST_SQUARES = 5
_PLACE_PX = 16  # side of the squares whose noise is compared with that of their neighbours
_LEAST_PAIRS = 30  # of such neighbours
_SMOOTH_M = 5e-4  # a square whose differences scatter more is no smooth surface
_FLAT_M = 5e-3
_PARABOLOID_M, _MOST_NEAR = 2e-3, 0.97
_SLOPE, _LEVEL = (0.5, 3.0), 0.25  # tangents of slopes along an axis, and across it at most
_LEAST_ON_SLOPES = 5000  # differences: of fewer, scans differ by chance
_STEP_M = 0.03
PLACES = ("seen", "left", "right", "upper", "lower", "unseen")
_UNKNOWN_Z = 5.0  # how far off a row is that the twin's scans cannot tell
_FAR_Z = 3.0  # what is farther off counts by its logarithm


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One statistic of the real scans and of a twin's."""

    name: str
    unit: str
    real: float
    spread: float  # standard deviation over the real scans, at least a share of the mean
    twin: float

    @property
    def off(self) -> float:
        """How many spreads the twin is off."""
        return (self.twin - self.real) / self.spread

    @property
    def is_met(self) -> bool:
        return abs(self.off) <= _SIGMAS


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """A set's rows, a number per scan; NaN where a scan cannot tell."""

    value: Mapping[str, Float[np.ndarray, " scans"]]

    @property
    def scans(self) -> int:
        """How many scans the figures are of."""
        return len(next(iter(self.value.values())))


def figures_of(
    scans: Iterable[DepthScan],
    floor: Float[np.ndarray, "3"] | None,
    places: Places | None = None,
) -> Figures:
    """All rows of each scan; if scans are made one by one, while the next one is made.

    Args:
        floor: the plane of `find_floor`, None where none was found.
        places: of `missing_places`; without them, missing depth is counted in the whole frame.
    """
    with ThreadPoolExecutor(max_workers=1) as pool:
        each = list(pool.map(lambda scan: _one(scan, floor, places or {}), scans))
    return Figures(value={name: np.array([one[name] for one in each]) for name in ROWS})


def compare(real: Figures, twin: Figures) -> tuple[Row, ...]:
    """Row by row; what neither tells is left out."""
    rows = []
    for name, (unit, least) in ROWS.items():
        known, own = (f.value[name][~np.isnan(f.value[name])] for f in (real, twin))
        if not len(known):
            continue
        mean = float(known.mean())
        spread = max(float(known.std(ddof=1)) if len(known) > 1 else 0.0, least)
        spread = max(spread, _LEAST_SPREAD * abs(mean))
        twin_mean = float(own.mean()) if len(own) else mean + _UNKNOWN_Z * spread
        rows.append(Row(name=name, unit=unit, real=mean, spread=spread, twin=twin_mean))
    return tuple(rows)


def pulls_of(rows: Sequence[Row]) -> Float[np.ndarray, " n"]:
    """How many spreads each row is off; far ones count by their logarithm.

    A few rows that no twin meets shall not decide alone, but a bound that is flat would hide which
    way leads nearer to them: the search would stay where many rows are far off.
    """
    off = np.array([row.off for row in rows])
    return _FAR_Z * np.arcsinh(off / _FAR_Z)


def loss_of(rows: Sequence[Row]) -> float:
    """Mean square of `pulls_of`."""
    return float((pulls_of(rows) ** 2).mean())


# name: unit, and the least spread that is believed
ROWS: dict[str, tuple[str, float]] = {
    "missing where a real scan has depth": ("%", 3.0),
    "missing on the bin's left side": ("%", 3.0),
    "missing on the bin's right side": ("%", 3.0),
    "missing on the bin's upper side": ("%", 3.0),
    "missing on the bin's lower side": ("%", 3.0),
    "missing where no real scan has depth": ("%", 3.0),
    "missing among present neighbours": ("%", 0.02),
    "holes of 1 px": ("per scan", 10.0),
    "holes of 2 to 4 px": ("per scan", 10.0),
    "holes of 5 to 10 px": ("per scan", 5.0),
    "specks of 1 px": ("per scan", 5.0),
    "specks of 2 to 4 px": ("per scan", 5.0),
    "specks of 5 to 10 px": ("per scan", 3.0),
    "jumps, right side farther": ("per scan", 3.0),
    "jumps, left side farther": ("per scan", 10.0),
    "jumps, lower side farther": ("per scan", 10.0),
    "jumps, upper side farther": ("per scan", 10.0),
    "flying at steps": ("%", 0.2),
    "fine noise, 10 %": ("mm", 0.003),
    "fine noise, 25 %": ("mm", 0.003),
    "fine noise, median": ("mm", 0.003),
    "fine noise, 75 %": ("mm", 0.003),
    "fine noise, 90 %": ("mm", 0.003),
    "fine noise, 0 to 10 deg": ("mm", 0.003),
    "fine noise, 10 to 20 deg": ("mm", 0.003),
    "fine noise, 20 to 30 deg": ("mm", 0.003),
    "fine noise, 30 to 40 deg": ("mm", 0.003),
    "fine noise, 40 to 50 deg": ("mm", 0.003),
    "fine noise, from place to place": ("%", 1.0),
    "fine noise of the floor": ("mm", 0.003),
    "holes in the floor": ("%", 0.05),
    "tiles that are rough": ("%", 0.3),
    "noise along x above fine noise": ("%", 2.0),
    "noise along y above fine noise": ("%", 2.0),
    "noise common to rows": ("", 0.02),
    "noise common to rows 2 px apart": ("", 0.02),
    "noise common to columns": ("", 0.02),
    "noise along x above fine noise, sloping along x": ("%", 2.0),
    "noise along y above fine noise, sloping along x": ("%", 2.0),
    "noise common to rows, sloping along x": ("", 0.02),
    "noise along y above fine noise, sloping along y": ("%", 2.0),
    "noise common to columns, sloping along y": ("", 0.02),
    "floor's noise common to rows": ("", 0.02),
    "tails of the floor's noise": ("%", 1.0),
    "tails of the noise": ("%", 1.0),
    "differences far out": ("%", 0.05),
    "holes in flat places": ("per 10 000", 1.0),
    "smooth squares without a hole": ("%", 2.0),
}


def _one(
    scan: DepthScan,
    floor: Float[np.ndarray, "3"] | None,
    places: Places,
) -> dict[str, float]:
    valid = scan.valid
    ring = valid[1:-1, :-2] & valid[1:-1, 2:] & valid[:-2, 1:-1] & valid[2:, 1:-1]
    gaps, steps, fine = count_missing(scan), count_steps(scan), measure_fine(scan)
    holes, specks = gaps.hole_sizes_px, gaps.speck_sizes_px
    at = [places.get(name, np.full(valid.shape, name == "seen")) for name in PLACES]
    missing = [float((~valid[one]).mean()) if one.any() else np.nan for one in at]
    among_present = (ring & ~valid[1:-1, 1:-1]).sum() / max(int(ring.sum()), 1)
    values = [100 * float(v) for v in (*missing, among_present)]
    for sizes in (holes, specks):
        values += [float(((sizes >= a) & (sizes <= b)).sum()) for a, b in ((1, 1), (2, 4), (5, 10))]
    values += [float(n) for n in (steps.right_farther, steps.left_farther)]
    values += [float(n) for n in (steps.below_farther, steps.above_farther)]
    values.append(100 * steps.flying / steps.step_pixels if steps.step_pixels else np.nan)
    sigma_mm = 1e3 * np.sqrt(fine.variance_m2 / median_over_mean())
    some = len(sigma_mm) >= 20
    values += np.percentile(sigma_mm, (10, 25, 50, 75, 90)).tolist() if some else [float("nan")] * 5
    degrees = np.degrees(fine.incidence_rad)
    for low in range(0, 50, 10):
        group = sigma_mm[(degrees >= low) & (degrees < low + 10)]
        values.append(float(np.median(group)) if len(group) >= 20 else float("nan"))
    values.append(_from_place_to_place(second_difference(scan.depth_m)))
    *of_floor, floor_shared, floor_tails = _floor(scan, floor)
    values += [*of_floor, 100 * (1 - len(sigma_mm) / max(fine.tiles, 1))]
    values += [*_texture(scan), *_on_slopes(scan), floor_shared, floor_tails]
    values += [*_tails(second_difference(scan.depth_m)), _flat_holes(scan)]
    values.append(_whole_squares(scan.depth_m))
    return dict(zip(ROWS, values, strict=True))


def _floor(scan: DepthScan, floor: Float[np.ndarray, "3"] | None) -> list[float]:
    """Of the bare floor: fine noise [mm], the share of holes [%], what rows share, tails [%]."""
    if floor is None:
        return [float("nan")] * 4
    row, column = np.mgrid[: scan.depth_m.shape[0], : scan.depth_m.shape[1]]
    inverse = floor[0] * column + floor[1] * row + floor[2]
    plane_m = 1.0 / np.where(inverse > 0, inverse, np.nan)
    on_floor = np.abs(scan.depth_m - plane_m) < 4e-3
    mixed = second_difference(np.where(on_floor, scan.depth_m, np.nan))
    known = mixed[~np.isnan(mixed)]
    ring = on_floor[1:-1, :-2] & on_floor[1:-1, 2:] & on_floor[:-2, 1:-1] & on_floor[2:, 1:-1]
    if len(known) < 500:
        return [float("nan")] * 4
    holes = (ring & ~scan.valid[1:-1, 1:-1]).sum() / max(int(ring.sum()), 1)
    along = third_difference(np.where(on_floor, scan.depth_m, np.nan))
    shared = float(correlation(along[:-1], along[1:]))
    return [1e3 * robust_sigma(known), 100 * float(holes), shared, _tails(mixed)[0]]


def _from_place_to_place(mixed: Float[np.ndarray, "h w"]) -> float:
    """How much the noise of a small square differs from that of its neighbours [%].

    Light and slope hardly change from one to the next, so this is the finish of the surface.
    """
    rows, columns = (n // _PLACE_PX for n in mixed.shape)
    squares = _squares(mixed, _PLACE_PX)
    sigma_m = np.full(len(squares), np.nan)
    known = (~np.isnan(squares)).mean(axis=1) >= _LEAST_KNOWN
    sigma_m[known] = robust_sigma(squares[known], axis=1)
    smooth = (sigma_m > 0) & (sigma_m < _SMOOTH_M)  # NaN is not
    log = np.log(np.where(smooth, sigma_m, np.nan)).reshape(rows, columns)
    differing = np.concatenate([np.diff(log, axis=0).ravel(), np.diff(log, axis=1).ravel()])
    differing = differing[~np.isnan(differing)]
    if len(differing) < _LEAST_PAIRS:
        return float("nan")
    return 100 * robust_sigma(differing) / np.sqrt(2)


def _texture(scan: DepthScan) -> list[float]:
    """By how much noise along rows and columns is above the fine noise [%]; what lines share.

    They are medians over squares of smooth surfaces, as a classifier judges squares.
    """
    z_m = _squares(scan.depth_m).reshape(-1, SQUARE_PX, SQUARE_PX)
    mixed = second_difference(z_m)
    known = (~np.isnan(mixed)).mean(axis=(1, 2)) >= _LEAST_KNOWN
    z_m, fine_m = z_m[known], robust_sigma(mixed[known], axis=(1, 2))
    smooth = (fine_m > 0) & (fine_m < _SMOOTH_M)  # depth without any noise has no texture
    if smooth.sum() < _LEAST_SQUARES:
        return [float("nan")] * 5
    z_m, fine_m = z_m[smooth], fine_m[smooth]
    along_x, along_y = third_difference(z_m), third_difference(z_m.swapaxes(1, 2))
    told = [100 * (robust_sigma(along, axis=(1, 2)) / fine_m - 1) for along in (along_x, along_y)]
    for along, apart in ((along_x, 1), (along_x, 2), (along_y, 1)):
        told.append(correlation(along[:, :-apart], along[:, apart:]))
    return [float(np.nanmedian(one)) for one in told]


def _on_slopes(scan: DepthScan) -> list[float]:
    """The texture of noise on surfaces that slope along x, and on those that slope along y.

    Noise of light does not know which way a surface slopes. Depth that was measured beside its
    pixel does: its error is the slope's, and has the correlations of the place along that axis.
    """
    z_m = _mean(scan.depth_m)
    down, right = np.gradient(z_m)
    across, along = right * scan.K[0, 0] / z_m, down * scan.K[1, 1] / z_m
    told = []
    for own, other, turned in ((across, along, False), (along, across, True)):
        with np.errstate(invalid="ignore"):  # NaN is not >
            slopes = (np.abs(own) > _SLOPE[0]) & (np.abs(own) < _SLOPE[1])
            slopes &= np.abs(other) < _LEVEL
        depth_m = np.where(slopes, scan.depth_m, np.nan)
        told.append(_ratios(depth_m.T if turned else depth_m))
    (along_x, along_y, rows), (along_y_of_y, _, columns) = told
    return [along_x, along_y, rows, along_y_of_y, columns]


def _ratios(depth_m: Float[np.ndarray, "h w"]) -> tuple[float, float, float]:
    """Noise along the rows and along the columns above the fine noise [%]; what rows share."""
    mixed = second_difference(depth_m)
    known = mixed[~np.isnan(mixed)]
    fine_m = robust_sigma(known)
    if len(known) < _LEAST_ON_SLOPES or not fine_m:
        return float("nan"), float("nan"), float("nan")
    along, across = third_difference(depth_m), third_difference(depth_m.T)
    ratios = [100 * (robust_sigma(a[~np.isnan(a)]) / fine_m - 1) for a in (along, across)]
    return ratios[0], ratios[1], float(correlation(along[:-1], along[1:]))


def _mean(depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Over 7 x 7 pixels that all have depth and lie within a step; NaN elsewhere."""
    known = np.isfinite(depth_m)
    filled = np.where(known, depth_m, 0.0)
    mean = ndimage.uniform_filter(filled, 7) / np.maximum(
        ndimage.uniform_filter(known.astype(np.float64), 7), 1e-9
    )
    low, high = (f(filled, 7) for f in (ndimage.minimum_filter, ndimage.maximum_filter))
    return np.where((low > 0) & (high - low < _STEP_M), mean, np.nan)


def _tails(mixed: Float[np.ndarray, "h w"]) -> list[float]:
    """By how much noise is wider than its median tells [%], and the share beyond 4 sigma [%].

    Of squares, since noise differs from place to place; a normal law has 0 and 0.006.
    """
    squares = _squares(mixed)
    squares = squares[(~np.isnan(squares)).mean(axis=1) >= _LEAST_KNOWN]
    if len(squares) < _LEAST_SQUARES:
        return [float("nan")] * 2
    sigma_m = robust_sigma(squares, axis=1)
    squares, sigma_m = squares[sigma_m < _SMOOTH_M], sigma_m[sigma_m < _SMOOTH_M][:, None]
    if len(squares) < _LEAST_SQUARES or not sigma_m.all():
        return [float("nan")] * 2
    far = np.abs(squares) >= 4 * sigma_m  # NaN is not
    core = np.nanstd(np.where(far, np.nan, squares), axis=1) / sigma_m[:, 0]
    share = far.sum(axis=1) / (~np.isnan(squares)).sum(axis=1)
    return [100 * float(np.median(core) - 1), 100 * float(np.median(share))]


def _flat_holes(scan: DepthScan) -> float:
    """Single pixels missing amid eight that lie within a few millimetres, of 10 000 such places."""
    height, width = scan.depth_m.shape
    around = [
        scan.depth_m[1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx]
        for dy in (-1, 0, 1)
        for dx in (-1, 0, 1)
        if dy or dx
    ]
    with np.errstate(invalid="ignore"):
        flat = np.maximum.reduce(around) - np.minimum.reduce(around) < _FLAT_M  # NaN is not
    return 1e4 * float((flat & ~scan.valid[1:-1, 1:-1]).sum() / max(int(flat.sum()), 1))


def _whole_squares(depth_m: Float[np.ndarray, "h w"]) -> float:
    """Of the smooth squares, the share [%] that has depth everywhere.

    Holes that stand together, as on a wall at the limit of the light, leave most squares whole;
    as many holes that are strewn about do not. A square is smooth if it has depth at 70 % of its
    pixels and if 97 % of these lie within 2 mm of a paraboloid.
    """
    z_m = _squares(depth_m)
    known = np.isfinite(z_m)
    enough = known.mean(axis=1) >= _LEAST_KNOWN
    z_m, known = z_m[enough], known[enough]
    t = np.linspace(-1, 1, SQUARE_PX)
    x, y = (c.ravel() for c in np.meshgrid(t, t))
    basis = np.stack([x**0, x, y, x * x, x * y, y * y], axis=-1)
    level = np.where(known, z_m, 0.0)
    A = np.einsum("np,pi,pj->nij", known.astype(np.float64), basis, basis, optimize=True)
    fit = np.linalg.solve(A, (level @ basis)[..., None])[..., 0] @ basis.T
    near = known & (np.abs(level - fit) <= _PARABOLOID_M)
    smooth = near.sum(axis=1) >= _MOST_NEAR * known.sum(axis=1)
    if smooth.sum() < _LEAST_SQUARES:
        return float("nan")
    return 100 * float(known[smooth].all(axis=1).mean())


def _squares(
    values: Float[np.ndarray, "h w"], side_px: int = SQUARE_PX
) -> Float[np.ndarray, "n pixels"]:
    """Squares beside each other; what is left at the right and lower borders is cut off."""
    rows, columns = (n // side_px * side_px for n in values.shape)
    cut = values[:rows, :columns].reshape(rows // side_px, side_px, -1, side_px)
    return cut.swapaxes(1, 2).reshape(-1, side_px**2)
