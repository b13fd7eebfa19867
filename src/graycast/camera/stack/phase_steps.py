"""Noise of stacks of phases, from the residuals of the steps of a period."""

from itertools import islice, pairwise

import numpy as np
from jaxtyping import Float, Num

from ...rig.pattern import Code
from .scatter import bands, less_local_mean, line

MAX_PERIODS = 4  # More periods say the same.
SURELY_HARMONIC = 3  # A response that is not linear puts its light into the harmonics up to here.


def full_periods(code: Code, *, kinds: tuple[str, ...] = ("phase", "line")) -> list[list[int]]:
    """Frames of each period that has all its steps, in their order."""
    groups: dict[tuple, dict[int, int]] = {}
    for k, frame in enumerate(code.frames):
        if frame.kind in kinds:
            whole, start = int(frame.step), frame.step % 1  # a cosine may begin between steps
            key = frame.axis, frame.kind, frame.period_px, frame.steps, start
            groups.setdefault(key, {})[whole] = k
    return [
        [steps[i] for i in range(key[3])] for key, steps in groups.items() if len(steps) == key[3]
    ]


def from_steps(
    frames: Num[np.ndarray, "n h w"], code: Code, offset_dn: float, saturation_dn: float
) -> tuple[float, float] | None:
    """Floor [DN^2] and slope [DN] from four or more steps of one cosine; None where there are none.

    Of N steps, the N - 3 numbers beside mean, cosine and sine are noise, and the harmonics of what
    is not linear: the highest frequencies over the steps are taken, of N > 7 those above the third,
    and off them what follows the phase within a band of rows.
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
                alone = 2 * k == count  # the highest of an even number has no imaginary part
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
    """Floor [DN^2] and slope [DN]: the means of two periods' steps are the same light."""
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
    """Values less what is a wave's harmonic of some order, by least squares over all of them.

    A harmonic's size follows the wave's own: as its first and second power, and its root.
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
