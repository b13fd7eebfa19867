"""Measurement of single depth maps, and the combined record of a set."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...base.errors import GraycastError
from .depth_steps import StepCounts, count_steps
from .fine import FineNoise, PairNoise, measure_fine, measure_pair, summarise_fine, summarise_pairs
from .gaps import Gaps, estimate_baseline, find_gaps
from .missing import MissingCounts, count_missing, summarise_islands, summarise_missing
from .noise import LAGS, PATCH_PX, PatchNoise, autocorrelation, measure_noise
from .realism_record import Autocorrelation, Jumps, Noise, Realism, Steps
from .scan import DepthScan

_PERCENTILES = (5, 25, 50, 75, 95)
_LEAST_PATCHES = 10  # Fewer patches do not determine an autocorrelation.


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """Counts and samples of one map, from which `pool` computes the record of a set."""

    median_depth_m: float  # NaN if no pixel is valid
    known_baseline_m: float | None
    missing: MissingCounts
    noise: PatchNoise
    fine: FineNoise
    pair: PairNoise | None  # with the previous map, if it is of the same camera
    steps: StepCounts
    gaps: tuple[Gaps, Gaps]  # along rows, along columns


def measure_all(scans: Iterable[DepthScan]) -> Iterator[Measurement]:
    """Yield the measurement of each map, including a comparison with the previous map."""
    before: DepthScan | None = None
    for scan in scans:
        yield measure_scan(scan, before=before)
        before = scan


def measure_scan(scan: DepthScan, *, before: DepthScan | None = None) -> Measurement:
    """Measure one depth map, and compare it with the map `before` it."""
    depth_m = scan.depth_m[scan.valid]
    return Measurement(
        median_depth_m=float(np.median(depth_m)) if depth_m.size else float("nan"),
        known_baseline_m=scan.baseline_m,
        missing=count_missing(scan),
        noise=measure_noise(scan),
        fine=measure_fine(scan),
        pair=None if before is None else measure_pair(before, scan),
        steps=count_steps(scan),
        gaps=find_gaps(scan),
    )


def pool(measurements: Iterable[Measurement], *, name: str) -> Realism:
    """Combine measurements into the record of a set by adding counts and joining samples.

    Raises:
        GraycastError: there are no maps.
    """
    maps = list(measurements)
    if not maps:
        raise GraycastError(f"{name}: it has no depth map: give at least one")
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
        fine=summarise_fine([m.fine for m in maps]),
        pairs=summarise_pairs([m.pair for m in maps if m.pair is not None]),
        autocorrelation=_autocorrelation([m.noise for m in maps]),
        jumps=Jumps(
            **{side: np.mean([getattr(m.steps, side) for m in maps]) for side in Jumps.model_fields}
        ),
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
    candidates, pixels = sum(m.candidates for m in maps), sum(m.pixels for m in maps)
    some = len(sigma_m) > 0
    return Noise(
        patch_px=PATCH_PX,
        candidates=candidates,
        patches=len(sigma_m),
        bent=1 - len(sigma_m) / candidates if candidates else None,
        outliers=sum(m.outliers for m in maps) / pixels if pixels else None,
        percentiles_m=np.percentile(sigma_m, _PERCENTILES).tolist() if some else None,
        relative=float(np.median(sigma_m / depth_m)) if some else None,
    )


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


def _steps(maps: Sequence[StepCounts]) -> Steps:
    pixels, flying = sum(m.step_pixels for m in maps), sum(m.flying for m in maps)
    return Steps(pixels=pixels / len(maps), flying=flying / pixels if pixels else None)
