"""Noise estimation from differences that light does not explain."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter

BAND_PX, MAX_BANDS = 32, 12  # Bands of rows are enough to measure the noise.
WINDOW_PX = 15  # Light is smooth over it; noise that a camera's own filters blurred is not.
# Squares are averaged below their 90 % quantile, which outliers do not reach; for a normal law that
# mean is this share of the variance. (Medians of whole numbers are coarse.)
TRIM, TRIMMED_SHARE = 0.9, 0.6235
BINS = 12  # The brightness is divided into so many bins.
MIN_IN_BIN = 200
QUANTISATION_DN2 = 1 / 12


def bands(height_px: int) -> Iterator[slice]:
    """Rows spread over the picture."""
    count = max(1, min(MAX_BANDS, height_px // BAND_PX))
    for y in np.linspace(0, max(height_px - BAND_PX, 0), count).astype(int):
        yield slice(y, min(y + BAND_PX, height_px))


def less_local_mean(
    value: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Values less the mean of the valid ones around; and where most around are valid."""
    share = uniform_filter(valid.astype(np.float32), WINDOW_PX)
    mean = uniform_filter(np.where(valid, value, 0), WINDOW_PX) / np.maximum(share, 0.1)
    return value - mean, valid & (share > 0.9)


def line(
    light_dn: Float[np.ndarray, "*n"],
    square_dn2: Float[np.ndarray, "*n"],
) -> tuple[float, float] | None:
    """Floor and slope of variance against light: a line through the mean of each brightness."""
    if len(light_dn) < MIN_IN_BIN:
        return None
    brightest = max(float(np.quantile(light_dn, 0.999)), 1.0)
    place = np.clip(light_dn * (BINS / brightest), 0, BINS - 1).astype(np.int64)
    x, y = [], []
    for b in range(BINS):
        inside = place == b
        if inside.sum() >= MIN_IN_BIN:
            x.append(max(float(np.median(light_dn[inside])), 0.0))
            y.append(_trimmed_mean(square_dn2[inside]) / TRIMMED_SHARE)
    if not x:
        return None
    light, square = np.array(x), np.array(y)
    slope = 0.0
    if np.ptp(light) > 0:
        slope = max(
            float(
                np.polyfit(light, square, 1, w=1 / (square + square.mean() + QUANTISATION_DN2))[0]
            ),
            0.0,
        )
    floor = float(np.median(square - slope * light))
    return max(floor, QUANTISATION_DN2), slope


def _trimmed_mean(value: Float[np.ndarray, " n"]) -> float:
    kept = np.sort(value)[: max(1, round(TRIM * len(value)))]
    return float(kept.mean())
