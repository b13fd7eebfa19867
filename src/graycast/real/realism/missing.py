"""Pixels without depth: their number, brightness and reasons, and small holes and specks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.optimize import isotonic_regression

from .realism_record import BinRecord, DropOut, Islands, Missing
from .scan import DepthScan

LEVELS = 4095  # The histogram of brightness resolves the levels of 8, 10 and 12 bits.
ISLAND_PX = 10
# Noise depends on the ratio of brightnesses, so bins are octaves; the last bin is saturation.
BRIGHTNESS_EDGES = np.array([0, *(2.0**-k for k in range(8, 0, -1)), 0.99, np.nextafter(1.0, 2.0)])
SIZES_PX = ((1, 1), (2, 4), (5, ISLAND_PX))  # smallest and largest size of each class of islands
_LEAST_DROP = 0.2  # least decrease of the missing share at a step
_NEIGHBOURS = np.ones((3, 3), dtype=int)


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingCounts:
    """Counts of pixels without depth, and sizes of small holes and specks, in one map."""

    pixels: int
    missing: int
    reasons: dict[str, int]
    total_at: Int[np.ndarray, " levels"] | None  # pixels per level of brightness
    missing_at: Int[np.ndarray, " levels"] | None
    hole_sizes_px: Int[np.ndarray, " holes"]
    speck_sizes_px: Int[np.ndarray, " specks"]


def count_missing(scan: DepthScan) -> MissingCounts:
    """Count the pixels of a map without depth, and measure its small holes and specks."""
    valid = scan.valid
    total_at = missing_at = None
    if scan.gray is not None:
        level = np.rint(scan.gray * LEVELS).astype(int)
        total_at = np.bincount(level.ravel(), minlength=LEVELS + 1)
        missing_at = np.bincount(level[~valid], minlength=LEVELS + 1)
    return MissingCounts(
        pixels=valid.size,
        missing=int((~valid).sum()),
        reasons=_reasons(scan),
        total_at=total_at,
        missing_at=missing_at,
        hole_sizes_px=_sizes(small_islands(~valid)),
        speck_sizes_px=_sizes(small_islands(valid)),
    )


def small_islands(mask: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Label groups of at most `ISLAND_PX` pixels in a mask with 1, 2, ...; 0 elsewhere.

    Pixels that touch at a side or a corner belong to one group. Groups at the border of the image
    do not count, because they may continue beyond it.
    """
    label, count = ndimage.label(mask, structure=_NEIGHBOURS)
    size = np.bincount(label.ravel(), minlength=count + 1)
    small = size <= ISLAND_PX
    small[0] = False
    for border in (label[0], label[-1], label[:, 0], label[:, -1]):
        small[border] = False
    number = np.cumsum(small) * small
    return number[label]


def missing_among(valid: Bool[np.ndarray, "h w"], among: Bool[np.ndarray, "h w"]) -> float:
    """Return the share of pixels without depth among those whose four neighbours are in a mask."""
    ring = among[1:-1, :-2] & among[1:-1, 2:] & among[:-2, 1:-1] & among[2:, 1:-1]
    return float((ring & ~valid[1:-1, 1:-1]).sum() / max(int(ring.sum()), 1))


def summarise_missing(counts: Sequence[MissingCounts]) -> Missing:
    """Return shares of missing pixels in all maps; shares by brightness use maps with a picture."""
    pixels = sum(c.pixels for c in counts)
    lit = [c for c in counts if c.total_at is not None]
    by_brightness, drop_out = [], None
    if lit:
        total_at = np.sum([c.total_at for c in lit if c.total_at is not None], axis=0)
        missing_at = np.sum([c.missing_at for c in lit if c.missing_at is not None], axis=0)
        by_brightness = _by_brightness(total_at, missing_at)
        drop_out = drop_out_step(total_at, missing_at)
    names = {name for c in counts for name in c.reasons}
    reasons = {name: sum(c.reasons.get(name, 0) for c in counts) / pixels for name in names}
    return Missing(
        share=sum(c.missing for c in counts) / pixels,
        by_brightness=by_brightness,
        by_reason=dict(sorted(reasons.items(), key=lambda item: -item[1])),
        drop_out=drop_out,
    )


def summarise_islands(counts: Sequence[MissingCounts]) -> Islands:
    pixels = sum(c.pixels for c in counts)
    holes = np.concatenate([c.hole_sizes_px for c in counts])
    specks = np.concatenate([c.speck_sizes_px for c in counts])
    return Islands(
        largest_px=ISLAND_PX,
        holes=len(holes) / len(counts),
        specks=len(specks) / len(counts),
        holes_by_size=_by_size(holes, len(counts)),
        specks_by_size=_by_size(specks, len(counts)),
        hole_share=float(holes.sum() / pixels),
        speck_share=float(specks.sum() / pixels),
    )


def _by_size(sizes_px: Int[np.ndarray, " n"], maps: int) -> dict[str, float]:
    counts = {size: ((sizes_px >= size[0]) & (sizes_px <= size[1])).sum() for size in SIZES_PX}
    return {
        f"{low}" if low == high else f"{low} to {high}": float(count / maps)
        for (low, high), count in counts.items()
    }


def drop_out_step(
    total_at: Int[np.ndarray, " levels"], missing_at: Int[np.ndarray, " levels"]
) -> DropOut | None:
    """Find the brightness at which the missing share falls in a step; None if there is no step.

    The step maximises the likelihood of two constant shares, below and above it (binomial
    distributions). Its width comes from a decreasing share fitted by isotonic regression. Saturated
    pixels are left out. Shadows are dark, too: in scenes with many shadows, they may contribute as
    much as drop-out to the share below the step.
    """
    end = int(BRIGHTNESS_EDGES[-2] * LEVELS)
    level = np.flatnonzero(total_at[:end])
    if len(level) < 2:
        return None
    total, missing = total_at[level].astype(float), missing_at[level].astype(float)
    below, missing_below = np.cumsum(total)[:-1], np.cumsum(missing)[:-1]
    above, missing_above = total.sum() - below, missing.sum() - missing_below
    likelihood = _binomial(below, missing_below) + _binomial(above, missing_above)
    at = int(np.argmax(likelihood))
    dark, bright = missing_below[at] / below[at], missing_above[at] / above[at]
    if dark - bright < _LEAST_DROP:
        return None
    falling = isotonic_regression(missing / total, weights=total, increasing=False).x
    quarter, half, three = (
        _crossing(level / LEVELS, falling, dark + part * (bright - dark))
        for part in (0.25, 0.5, 0.75)
    )
    return DropOut(
        brightness=half, first=quarter, last=three, missing_below=dark, missing_above=bright
    )


def _binomial(
    total: Float[np.ndarray, " n"], missing: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the log likelihood of the counts for the most likely constant share."""
    share = np.clip(missing / total, 1e-12, 1 - 1e-12)
    return missing * np.log(share) + (total - missing) * np.log1p(-share)


def _crossing(
    level: Float[np.ndarray, " n"], falling: Float[np.ndarray, " n"], value: float
) -> float:
    """Return the middle between the last level above the value and the first level at or below."""
    after = int(np.argmax(falling <= value))
    return float((level[max(after - 1, 0)] + level[after]) / 2)


def _by_brightness(
    total_at: Int[np.ndarray, " levels"], missing_at: Int[np.ndarray, " levels"]
) -> list[BinRecord]:
    place = np.digitize(np.arange(LEVELS + 1) / LEVELS, BRIGHTNESS_EDGES) - 1
    count = len(BRIGHTNESS_EDGES) - 1
    total = np.bincount(place, total_at, minlength=count)
    missing = np.bincount(place, missing_at, minlength=count)
    return [
        BinRecord(low=low, high=high, count=int(n), value=m / n if n else None)
        for low, high, n, m in zip(
            BRIGHTNESS_EDGES[:-1], BRIGHTNESS_EDGES[1:], total, missing, strict=True
        )
    ]


def _reasons(scan: DepthScan) -> dict[str, int]:
    """Count the missing pixels per reason; a reason without a name is named by its number."""
    if scan.reason is None:
        return {}
    number, count = np.unique(scan.reason[~scan.valid], return_counts=True)
    names = [scan.reason_names.get(int(n), f"reason {n}").lower() for n in number]
    return {name: int(n) for name, n in zip(names, count, strict=True)}


def _sizes(label: Int[np.ndarray, "h w"]) -> Int[np.ndarray, " groups"]:
    return np.bincount(label.ravel())[1:]
