"""Measure offset, saturation and noise of an unknown camera in the stack itself.

Noise is the variation that light does not explain in sums of pairs, in a period, or in a picture.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np
from jaxtyping import Bool, Float, Num, UInt8, UInt16
from scipy.ndimage import convolve, uniform_filter

from ...base.errors import DecodeError
from ...base.public_value import public_value
from ...rig.pattern import Code
from ..decode import Levels
from .computed import computed_pairs
from .description import LevelsSection
from .frame_groups import full_periods, inverse_pairs, opposite_steps

Stack = UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"]

FULL_SCALES = (1023, 4095, 16383, 65535)  # Largest values of 10 to 16 bits that are stored in 16.
PILE_SHARE = 1e-3  # If more lit pixels than this share have the highest value, it is saturation.
MAX_PAIRS = 8  # The number of coarse pairs that are used; the finest have edges everywhere.
FIRM = 0.8  # Next to edges, |pattern - inverse| is below this share of the contrast.
# Assumption for an unknown camera: dark noise of 1/250 of the range, and a full well of 10,000 e.
DEFAULT_NOISE, DEFAULT_WELL_E = 1 / 250, 10_000.0
MAX_PERIODS = 4  # More periods do not improve the result.
SURELY_HARMONIC = 3  # A non-linear response affects the harmonics up to this order.
BAND_PX, MAX_BANDS = 32, 12  # A few bands of rows are enough to measure the noise.
WINDOW_PX = 15  # Light is smooth over this window, but noise is not, even after a camera's filters.
# The mean of squares below their 90 % quantile is robust against outliers. For a normal law it is
# this share of the variance. A median would be coarse, because the values are whole numbers.
TRIM, TRIMMED_SHARE = 0.9, 0.6235
BINS = 12  # The number of bins of brightness.
MIN_IN_BIN = 200
QUANTISATION_DN2 = 1 / 12
ONE_MEAN = "texture of a period's mean"


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredLevels:
    """Measured levels, and a text with the source of each."""

    levels: Levels
    source: str


def measure_levels(frames: Stack, code: Code, known: LevelsSection) -> MeasuredLevels:
    """Measure offset, saturation and noise law of the camera that took a stack.

    - Saturation: the largest number of the bit depth (8 bits: 255; in 16 bits the smallest of 1023,
      4095, 16383 and 65535 that is not exceeded), or the highest value in the stack if it is within
      a tenth of that and many pixels have it.
    - Offset: the first percentile of the darkest values.
    - Noise: pattern plus inverse is the same light for every bit, so two such sums differ by the
      noise of four frames. The mean over 15 x 15 pixels is subtracted, which removes drift and the
      effect of gamma on indirect light. Only lit pixels well inside a stripe count. A fit against
      brightness gives floor and slope. Without inverses, phases are used: the residuals of four or
      more steps after mean, cosine and low harmonics, or else the differences between the means of
      two periods. Otherwise a 3 x 3 mask that is blind to planes (Immerkaer) is applied to the
      smoother half of the white frame, or of the mean of a period's steps. Without all of these, a
      default is used. See docs/explanation/depth.md, "Real stacks".

    Values in the stack file take precedence.

    Raises:
        DecodeError: the stated offset is above saturation.

    Leaves out: gamma, with which noise decreases with brightness and does not increase.

    Source: J. Immerkaer, "Fast Noise Variance Estimation", CVIU 64, 1996.
    """
    high, low = frames.max(axis=0), frames.min(axis=0)
    words = []
    saturation_dn, why = _saturation(high, low, frames.dtype)
    if known.saturation_dn is not None:
        saturation_dn, why = known.saturation_dn, "as stated"
    words.append(f"saturation {saturation_dn:g} DN ({why})")
    offset_dn, why = float(np.percentile(low, 1)), "darkest frame, first percentile"
    if known.offset_dn is not None:
        if known.offset_dn >= saturation_dn:
            raise DecodeError(
                f"levels.offset_dn is {known.offset_dn:g}, but pixels saturate at "
                f"{saturation_dn:g} DN: the two may be exchanged"
            )
        offset_dn, why = known.offset_dn, "as stated"
    offset_dn = min(offset_dn, saturation_dn - 1)
    words.append(f"offset {offset_dn:g} DN ({why})")
    floor_dn2, slope_dn, why = _noise(frames, code, high, low, offset_dn, saturation_dn)
    if known.read_noise_dn is not None:
        floor_dn2, why = known.read_noise_dn**2 + QUANTISATION_DN2, "as stated"
    if known.gain_dn_per_e is not None:
        slope_dn, why = known.gain_dn_per_e, "as stated"
    bright = np.sqrt(floor_dn2 + slope_dn * (saturation_dn - offset_dn))
    words.append(f"noise {np.sqrt(floor_dn2):.2f} DN dark to {bright:.2f} DN bright ({why})")
    levels = Levels(
        offset_dn=offset_dn,
        saturation_dn=saturation_dn,
        floor_dn2=floor_dn2,
        slope_dn=slope_dn,
    )
    return MeasuredLevels(levels=levels, source=", ".join(words))


def _saturation(high, low, dtype) -> tuple[float, str]:
    highest = int(high.max())
    scales = (255,) if dtype == np.uint8 else FULL_SCALES
    full = next(scale for scale in scales if highest <= scale)
    lit = high > int(low.min()) + 0.1 * (highest - int(low.min()))
    pile = int((high == highest).sum())
    if highest < full and highest >= 0.9 * full and pile > max(PILE_SHARE * lit.sum(), 20):
        return float(highest), f"the highest value, of {pile} pixels"
    return float(full), f"{full.bit_length()} bits"


def _noise(
    frames: Stack, code: Code, high, low, offset_dn: float, saturation_dn: float
) -> tuple[float, float, str]:
    """Return the noise variance's floor [DN^2] and slope [DN], and how they were measured."""
    bounds = offset_dn, saturation_dn
    computed = set(computed_pairs(frames, code))  # A computed frame lacks the noise of a picture.
    pairs = [pair for pair in inverse_pairs(code) if pair not in computed]
    measured_steps = computed.isdisjoint(opposite_steps(code))
    for measure, why in (
        (lambda: _from_pairs(frames, pairs, high, low, *bounds), "inverses"),
        (lambda: measured_steps and from_steps(frames, code, *bounds), "what phase steps leave"),
        (lambda: measured_steps and from_means(frames, code, *bounds), "means of periods"),
        (lambda: _from_white(frames, code, *bounds), "white frame"),
        (lambda: measured_steps and _from_one_mean(frames, code, *bounds), ONE_MEAN),
    ):
        law = measure()
        if law:
            return *law, f"measured: {why}"
    range_dn = saturation_dn - offset_dn
    floor_dn2 = (DEFAULT_NOISE * range_dn) ** 2 + QUANTISATION_DN2
    return floor_dn2, range_dn / DEFAULT_WELL_E, "assumed: no inverses, phases or white frame"


def _from_pairs(frames, pairs, high, low, offset_dn, saturation_dn):
    """Measure noise in differences of the sums of adjacent pairs, minus smooth light."""
    if len(pairs) < 2:
        return None
    light, squares = [], []
    for rows in bands(high.shape[0]):
        contrast = high[rows].astype(np.float32) - low[rows]
        before = None
        for pair in pairs[:MAX_PAIRS]:
            first, second = (frames[k, rows].astype(np.float32) for k in pair)
            firm = np.abs(first - second) >= FIRM * contrast
            firm &= (contrast > 0.02 * saturation_dn) & (high[rows] < saturation_dn)
            whole = first + second
            if before is not None:
                off, there = less_local_mean(whole - before[0], firm & before[1])
                light.append((whole + before[0])[there] / 4 - offset_dn)
                squares.append(off[there] ** 2 / 4)
            before = whole, firm
    return line(np.concatenate(light), np.concatenate(squares))


_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)


def _from_white(frames, code: Code, offset_dn, saturation_dn):
    whites = [k for k, frame in enumerate(code.frames) if frame.kind == "white"]
    return _from_texture(frames[whites[0]], offset_dn, saturation_dn) if whites else None


def _from_one_mean(frames, code: Code, offset_dn, saturation_dn):
    """Measure noise in the mean of N steps, which has no stripes and 1/N of a frame's variance."""
    steps = full_periods(code)
    if not steps:
        return None
    mean = frames[steps[0]].mean(axis=0, dtype=np.float32)
    law = _from_texture(mean, offset_dn, saturation_dn)
    return None if law is None else tuple(len(steps[0]) * term for term in law)


def _from_texture(white: Num[np.ndarray, "h w"], offset_dn, saturation_dn):
    """Measure noise in one picture, from the smoother half of its pixels."""
    value = white.astype(np.float32)
    square_dn2 = convolve(value, _MASK)[1:-1, 1:-1] ** 2 / 36
    mean = uniform_filter(value, 7)[1:-1, 1:-1]
    rough = uniform_filter(square_dn2, 7)
    keep = (mean < 0.95 * saturation_dn) & (rough <= np.median(rough))
    return line(mean[keep] - offset_dn, square_dn2[keep])


# --- steps of phases ---------------------------------------------------------------------------


def from_steps(
    frames: Num[np.ndarray, "n h w"], code: Code, offset_dn: float, saturation_dn: float
) -> tuple[float, float] | None:
    """Return floor [DN^2] and slope [DN] from four or more steps of a cosine, or None without them.

    In N steps, the N - 3 components other than mean, cosine and sine are noise, and harmonics of a
    non-linear response. The highest frequencies are used (for N > 7 those above the third), after
    subtraction of the part that correlates with the phase within a band of rows.
    """
    light, squares = [], []
    for steps in [s for s in full_periods(code, kinds=("phase",)) if len(s) > 3][:MAX_PERIODS]:
        count = len(steps)
        first = min(count // 2, SURELY_HARMONIC + 1)
        for rows in bands(frames.shape[1]):
            values = frames[steps, rows].astype(np.float32)
            valid = values.max(axis=0) < saturation_dn
            spectrum = np.fft.rfft(values, axis=0).astype(np.complex64)
            for k in range(first, count // 2 + 1):
                alone = 2 * k == count  # With an even count, the highest frequency is real.
                scale = np.sqrt((1 if alone else 2) / count).astype(np.float32)
                for part in (spectrum[k].real, spectrum[k].imag)[: 1 if alone else 2]:
                    rest = _less_harmonics(
                        scale * part, [(spectrum[1], k), (spectrum[1], count - k)]
                    )
                    rest, there = less_local_mean(rest, valid)
                    light.append(values.mean(axis=0)[there] - offset_dn)
                    squares.append(rest[there] ** 2)
    return line(np.concatenate(light), np.concatenate(squares)) if light else None


def from_means(
    frames: Num[np.ndarray, "n h w"], code: Code, offset_dn: float, saturation_dn: float
) -> tuple[float, float] | None:
    """Return floor [DN^2] and slope [DN] from pairs of periods, whose mean light is the same."""
    periods = full_periods(code)
    light, squares = [], []
    for pair in islice(pairwise(periods), MAX_PERIODS):
        for rows in bands(frames.shape[1]):
            values = [frames[steps, rows].astype(np.float32) for steps in pair]
            valid = np.maximum(*(s.max(axis=0) for s in values)) < saturation_dn
            means = [s.mean(axis=0) for s in values]
            waves = [(np.fft.rfft(s, axis=0)[1].astype(np.complex64), len(s)) for s in values]
            rest = _less_harmonics(means[0] - means[1], waves)
            rest, there = less_local_mean(rest, valid)
            light.append((means[0] + means[1])[there] / 2 - offset_dn)
            squares.append(rest[there] ** 2 / sum(1 / len(steps) for steps in pair))
    return line(np.concatenate(light), np.concatenate(squares)) if light else None


def _less_harmonics(
    value: Float[np.ndarray, "h w"], waves: list[tuple[np.ndarray, int]]
) -> Float[np.ndarray, "h w"]:
    """Subtract the harmonics of waves from values, by least squares over all harmonics.

    A harmonic's amplitude may be proportional to the wave's amplitude, its square or its root.
    """
    terms = []
    for wave, order in waves:
        size = np.abs(wave)
        turned = (wave / np.maximum(size, 1e-6)) ** order
        share = size / max(float(size.max()), 1e-6)
        for strength in (share, share**2, np.sqrt(share)):
            terms += [(strength * turned.real).ravel(), (strength * turned.imag).ravel()]
    term = np.array(terms, dtype=np.float64)
    weights = np.linalg.lstsq(term @ term.T, term @ value.ravel().astype(np.float64), rcond=1e-9)
    return value - (weights[0] @ term).reshape(value.shape).astype(np.float32)


# --- variance against light --------------------------------------------------------------------


def bands(height_px: int) -> Iterator[slice]:
    """Yield bands of rows that are spread over the picture."""
    count = max(1, min(MAX_BANDS, height_px // BAND_PX))
    for y in np.linspace(0, max(height_px - BAND_PX, 0), count).astype(int):
        yield slice(y, min(y + BAND_PX, height_px))


def less_local_mean(
    value: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return values minus the mean of nearby valid pixels, and a mask where most are valid."""
    share = uniform_filter(valid.astype(np.float32), WINDOW_PX)
    mean = uniform_filter(np.where(valid, value, 0), WINDOW_PX) / np.maximum(share, 0.1)
    return value - mean, valid & (share > 0.9)


def line(
    light_dn: Float[np.ndarray, "*n"],
    square_dn2: Float[np.ndarray, "*n"],
) -> tuple[float, float] | None:
    """Fit a line through the bins' means; return floor and slope of the variance against light."""
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
        weight = 1 / (square + square.mean() + QUANTISATION_DN2)
        slope = max(float(np.polyfit(light, square, 1, w=weight)[0]), 0.0)
    floor = float(np.median(square - slope * light))
    return max(floor, QUANTISATION_DN2), slope


def _trimmed_mean(value: Float[np.ndarray, " n"]) -> float:
    return float(np.sort(value)[: max(1, round(TRIM * len(value)))].mean())
