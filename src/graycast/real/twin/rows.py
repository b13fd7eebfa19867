"""The statistics that a twin should share with real scans; each row has one number per scan.

The twin scans the scenes of the real scans, so every difference is due to the sensor.
"""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from ...base.robust import robust_sigma
from ..realism import DepthScan
from ..realism.fine import measure_fine, median_over_mean
from ..realism.missing import SIZES_PX, count_missing, missing_among
from ..realism.patches import (
    SQUARE_PX,
    correlation,
    depth_of_floor,
    second_difference,
    third_difference,
)
from ..realism.scan import tiles

Places = Mapping[str, Bool[np.ndarray, "h w"]]  # masks by `PLACES`: pixels for missing depth
_SIGMAS = 2.0  # A row is met within this many standard deviations of the real mean.
_LEAST_SPREAD = 0.05  # least spread as a share of the mean, because few scans may agree by chance
_LEAST_KNOWN = 0.7  # Squares with a smaller share of known second differences are not used.
_LEAST_SQUARES, _LEAST_TILES, _LEAST_ON_FLOOR = 5, 20, 500  # With fewer, scans differ by chance.
_SMOOTH_M = 5e-4  # A square with a larger scatter of differences is not a smooth surface.
PLACES = ("visible", "left", "right", "upper", "lower", "blind")
_UNKNOWN_Z = 5.0  # assumed deviation [spreads] of a row without a value in the twin's scans
_FAR_Z = 3.0  # Larger deviations [spreads] grow only logarithmically.


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One statistic of the real scans and of the twin's scans."""

    name: str
    unit: str
    real: float
    spread: float  # standard deviation over the real scans, at least a share of the mean
    twin: float

    @property
    def off(self) -> float:
        """Deviation of the twin from the real scans, in spreads."""
        return (self.twin - self.real) / self.spread

    @property
    def is_met(self) -> bool:
        return abs(self.off) <= _SIGMAS


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """The statistics of a set of scans: a number per scan, NaN if it is unknown.

    `places` has masks of the pixels at which missing depth was counted; empty means all pixels.
    """

    value: Mapping[str, Float[np.ndarray, " scans"]]
    places: Places = field(default_factory=dict)

    @property
    def scans(self) -> int:
        """Number of scans behind the figures."""
        return len(next(iter(self.value.values())))


def figures_of(
    scans: Iterable[DepthScan],
    floor: Float[np.ndarray, "3"] | None,
    places: Places | None = None,
) -> Figures:
    """Return the statistics of each scan, computed while the iterator makes the next scan.

    Args:
        floor: the plane from `find_floor`, or None.
        places: the masks from `missing_places`; None counts missing depth at all pixels.
    """
    with ThreadPoolExecutor(max_workers=1) as pool:
        each = list(pool.map(lambda scan: _one(scan, floor, places or {}), scans))
    value = {name: np.array([one[name] for one in each]) for name in ROWS}
    return Figures(value=value, places=places or {})


def compare(real: Figures, twin: Figures) -> tuple[Row, ...]:
    """Return a row for each statistic that is known for the real scans."""
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
    """Return the deviation of each row in spreads; large deviations are compressed.

    A few rows that no twin meets must not dominate. A fixed bound would make their derivative zero,
    and the search would stop while many rows are far off; so they grow logarithmically.
    """
    off = np.array([row.off for row in rows])
    return _FAR_Z * np.arcsinh(off / _FAR_Z)


def loss_of(rows: Sequence[Row]) -> float:
    """Return the mean square of `pulls_of`."""
    return float((pulls_of(rows) ** 2).mean())


# Unit and smallest accepted spread of each row.
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
    "fine noise of the floor": ("mm", 0.003),
    "holes in the floor": ("%", 0.05),
    "noise along x above fine noise": ("%", 2.0),
    "noise along y above fine noise": ("%", 2.0),
    "noise common to rows": ("", 0.02),
    "noise common to columns": ("", 0.02),
}


def _one(
    scan: DepthScan,
    floor: Float[np.ndarray, "3"] | None,
    places: Places,
) -> dict[str, float]:
    valid = scan.valid
    gaps, fine = count_missing(scan), measure_fine(scan)
    at = [places.get(name, np.full(valid.shape, name == "visible")) for name in PLACES]
    missing = [float((~valid[one]).mean()) if one.any() else np.nan for one in at]
    values = [100 * v for v in (*missing, missing_among(valid, valid))]
    for sizes in (gaps.hole_sizes_px, gaps.speck_sizes_px):
        values += [float(((sizes >= a) & (sizes <= b)).sum()) for a, b in SIZES_PX]
    sigma_mm = 1e3 * np.sqrt(fine.variance_m2 / median_over_mean())
    degrees = np.degrees(fine.incidence_rad)
    values += [_percentile(sigma_mm, share) for share in (10, 25, 50, 75, 90)]
    for low in range(0, 50, 10):
        values.append(_percentile(sigma_mm[(degrees >= low) & (degrees < low + 10)], 50))
    values += [*_floor(scan, floor), *_texture(scan)]
    return dict(zip(ROWS, values, strict=True))


def _percentile(sigma_mm: Float[np.ndarray, " n"], share: int) -> float:
    """Return a percentile; NaN if there are fewer than `_LEAST_TILES` values."""
    return float(np.percentile(sigma_mm, share)) if len(sigma_mm) >= _LEAST_TILES else np.nan


def _floor(scan: DepthScan, floor: Float[np.ndarray, "3"] | None) -> list[float]:
    """Return the fine noise [mm] and the share of holes [%] of the visible floor."""
    if floor is None:
        return [float("nan")] * 2
    plane_m = depth_of_floor(floor, *map(slice, scan.depth_m.shape))
    on_floor = np.abs(scan.depth_m - plane_m) < 4e-3
    mixed = second_difference(np.where(on_floor, scan.depth_m, np.nan))
    known = mixed[~np.isnan(mixed)]
    if len(known) < _LEAST_ON_FLOOR:
        return [float("nan")] * 2
    return [1e3 * robust_sigma(known), 100 * missing_among(scan.valid, on_floor)]


def _texture(scan: DepthScan) -> list[float]:
    """Return the excess of noise along x and y over the fine noise [%], and the line noise.

    Line noise is the correlation between neighbouring lines. The results are medians over squares
    on smooth surfaces, because the classifier also uses squares.
    """
    z_m = tiles(scan.depth_m, SQUARE_PX)
    mixed = second_difference(z_m)
    known = (~np.isnan(mixed)).mean(axis=(1, 2)) >= _LEAST_KNOWN
    z_m, fine_m = z_m[known], robust_sigma(mixed[known], axis=(1, 2))
    smooth = (fine_m > 0) & (fine_m < _SMOOTH_M)  # Without any noise, ratios to it are undefined.
    if smooth.sum() < _LEAST_SQUARES:
        return [float("nan")] * 4
    z_m, fine_m = z_m[smooth], fine_m[smooth]
    alongs = third_difference(z_m), third_difference(z_m.swapaxes(1, 2))
    above = [100 * (robust_sigma(along, axis=(1, 2)) / fine_m - 1) for along in alongs]
    common = [correlation(along[:, :-1], along[:, 1:]) for along in alongs]
    return [float(np.nanmedian(one)) for one in (*above, *common)]
