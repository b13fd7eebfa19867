"""A depth map into counts and samples, and those of many maps into one record."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...errors import GraycastError
from .gaps import Gaps, estimate_baseline, find_gaps
from .missing import (
    BRIGHTNESS_EDGES,
    MissingCounts,
    count_missing,
    summarise_islands,
    summarise_missing,
)
from .noise import LAGS, PATCH_PX, PatchNoise, autocorrelation, measure_noise
from .record import Autocorrelation, Bin, Jumps, Noise, Realism, Steps
from .scan import Scan
from .steps import StepCounts, count_steps

INCIDENCE_EDGES_DEG = np.arange(0.0, 90.0, 10.0)
_PERCENTILES = (5, 25, 50, 75, 95)
_FACING_DEG = 45.0  # noise is compared over brightness up to there
_LEAST_PATCHES = 10  # in a bin, to be compared with another


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """What one map adds to a set's record."""

    median_depth_m: float  # NaN where nothing is valid
    known_baseline_m: float | None
    missing: MissingCounts
    noise: PatchNoise
    steps: StepCounts
    gaps: tuple[Gaps, Gaps]  # along rows, along columns


def measure(scan: Scan) -> Measurement:
    """Everything that is counted in one depth map."""
    depth_m = scan.depth_m[scan.valid]
    return Measurement(
        median_depth_m=float(np.median(depth_m)) if depth_m.size else float("nan"),
        known_baseline_m=scan.baseline_m,
        missing=count_missing(scan),
        noise=measure_noise(scan),
        steps=count_steps(scan),
        gaps=find_gaps(scan),
    )


def pool(measurements: Iterable[Measurement], *, name: str) -> Realism:
    """The record of a set: counts are added, samples put together, whatever map they came from.

    Raises:
        GraycastError: there is no map in the set.
    """
    maps = list(measurements)
    if not maps:
        raise GraycastError(f"{name}: no depth map to measure: give at least one")
    missing = [m.missing for m in maps]
    depths = [m.median_depth_m for m in maps if not np.isnan(m.median_depth_m)]
    known = {m.known_baseline_m for m in maps}
    return Realism(
        name=name,
        scans=len(maps),
        pixels=sum(m.pixels for m in missing),
        median_depth_m=float(np.median(depths)) if depths else None,
        missing=summarise_missing(missing),
        noise=_noise([m.noise for m in maps]),
        autocorrelation=_autocorrelation([m.noise for m in maps]),
        jumps=_jumps([m.steps for m in maps]),
        steps=_steps([m.steps for m in maps]),
        baseline=estimate_baseline(
            [m.gaps[0] for m in maps],
            [m.gaps[1] for m in maps],
            known.pop() if len(known) == 1 else None,
        ),
        islands=summarise_islands(missing),
    )


def _noise(maps: Sequence[PatchNoise]) -> Noise:
    sigma_m = np.concatenate([m.sigma_m for m in maps])
    depth_m = np.concatenate([m.depth_m for m in maps])
    incidence_deg = np.degrees(np.concatenate([m.incidence_rad for m in maps]))
    brightness = np.concatenate([m.brightness for m in maps])
    candidates, pixels = sum(m.candidates for m in maps), sum(m.pixels for m in maps)
    shown = (incidence_deg < _FACING_DEG) & ~np.isnan(brightness)
    by_brightness = _bins(brightness[shown], sigma_m[shown], BRIGHTNESS_EDGES)
    enough = [b.value for b in by_brightness[:-1] if b.value and b.count >= _LEAST_PATCHES]
    facing = sigma_m[incidence_deg < 20]
    steep = sigma_m[(incidence_deg >= 50) & (incidence_deg < 70)]
    comparable = min(len(facing), len(steep)) >= _LEAST_PATCHES
    some = len(sigma_m) > 0
    return Noise(
        patch_px=PATCH_PX,
        candidates=candidates,
        patches=len(sigma_m),
        bent=1 - len(sigma_m) / candidates if candidates else None,
        outliers=sum(m.outliers for m in maps) / pixels if pixels else None,
        percentiles_m=np.percentile(sigma_m, _PERCENTILES).tolist() if some else None,
        relative=float(np.median(sigma_m / depth_m)) if some else None,
        by_brightness=by_brightness if shown.any() else [],
        by_incidence=_bins(incidence_deg, sigma_m, INCIDENCE_EDGES_DEG),
        dark_to_bright=enough[0] / enough[-1] if len(enough) > 1 else None,
        steep_to_facing=float(np.median(steep) / np.median(facing)) if comparable else None,
    )


def _bins(
    of: Float[np.ndarray, " n"], sigma_m: Float[np.ndarray, " n"], edges: Float[np.ndarray, " e"]
) -> list[Bin]:
    """Median noise between the edges."""
    place = np.digitize(of, edges) - 1
    groups = [sigma_m[place == i] for i in range(len(edges) - 1)]
    return [
        Bin(low=low, high=high, count=len(group), value=np.median(group) if len(group) else None)
        for low, high, group in zip(edges[:-1], edges[1:], groups, strict=True)
    ]


def _autocorrelation(maps: Sequence[PatchNoise]) -> Autocorrelation:
    whole = sum(m.whole for m in maps)
    if whole < _LEAST_PATCHES:
        return Autocorrelation(patches=whole, along_rows=None, along_columns=None)
    value = autocorrelation(np.sum([m.products for m in maps], axis=0) / whole)
    return Autocorrelation(
        patches=whole,
        along_rows=[float(value[LAGS.index((k, 0))]) for k in (1, 2, 3)],
        along_columns=[float(value[LAGS.index((0, k))]) for k in (1, 2, 3)],
    )


def _jumps(maps: Sequence[StepCounts]) -> Jumps:
    return Jumps(
        right_farther=np.mean([m.right_farther for m in maps]),
        left_farther=np.mean([m.left_farther for m in maps]),
        below_farther=np.mean([m.below_farther for m in maps]),
        above_farther=np.mean([m.above_farther for m in maps]),
    )


def _steps(maps: Sequence[StepCounts]) -> Steps:
    pixels, flying = sum(m.step_pixels for m in maps), sum(m.flying for m in maps)
    return Steps(pixels=pixels / len(maps), flying=flying / pixels if pixels else None)
