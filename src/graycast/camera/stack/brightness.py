"""Detect single phase steps that are brighter or darker than the others of their period."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...rig.pattern import Code
from .frame_groups import full_periods, inverse_pairs
from .levels import Stack
from .stack_figures import samples

LEAST = 0.05  # A smaller difference causes no warning, because a flicker of 1 % is usual.
# The uncertainty of a gain is this model error divided by the condition of the equations: if few
# phases are visible, cosine, sine and mean cannot be distinguished.
MODEL = 0.004
SURE_SIGMAS = 5.0  # A gain must differ from 1 by this many times its sigma.
# A larger median misfit, relative to the mean, is caused by steps in a wrong order.
LEFT = 0.08
CHUNKS = 24  # Sigma follows from the scatter between this many groups of pixels.
FEWEST, MOST = 500, 10_000  # The fewest pixels that are enough, and the most that are used.
BINS = 16  # Each bin of the phase histogram has the same weight.
ROUNDS, FAR = 4, 3.0  # Rounds of the robust fit, and its scale in median residuals.


def brightness_faults(
    frames: Stack,
    code: Code,
    names: Sequence[str],
    well: Bool[np.ndarray, "h w"],
    saturation_dn: float,
    *,
    exchanged: frozenset[int] = frozenset(),
) -> Iterator[str]:
    """Yield a warning for each step that is brighter or darker than the others of its period.

    Leaves out: periods with fewer than three steps; a single period of three steps without any
    white picture, because three values determine a cosine exactly and leave no check; shifted
    lines, which are no cosines.

    Args:
        exchanged: frames of periods to leave out because two of their pictures are exchanged,
            which looks like unequal brightness.
    """
    index = samples(well)
    index = index[:: max(1, len(index) // MOST)]
    if len(index) < FEWEST:
        return
    flat = frames.reshape(len(frames), -1)[:, index].astype(np.float64)
    for steps in full_periods(code, kinds=("phase",)):
        if not exchanged.isdisjoint(steps):
            continue
        gain = step_gains(flat, code, steps, saturation_dn)
        if gain is None:
            continue
        for k in np.flatnonzero(gain != 1.0):
            frame = code.frames[steps[k]]
            off_px = frame.period_px * _turns_off(gain[k] - 1, len(steps))
            yield (
                f"{frame.name} ({names[steps[k]]}) is {gain[k]:.2f} times as bright as the other "
                f"steps of its period, which moves places by up to {off_px:.2g} px, beyond their "
                "sigma: take it again with the same exposure and light"
            )


def _turns_off(excess: float, steps: int) -> float:
    """Return the largest phase error from one brighter step at full modulation [turns].

    A step at phase 0 adds `excess (1 + cos(phase))` to the sum `steps / 2 exp(i phase)`. This
    turns the sum by `excess (1 + cos) sin / (steps / 2)`, which is at most
    `1.3 excess / (steps / 2)`.
    """
    return abs(excess) * 1.3 / (steps / 2) / (2 * math.pi)


def step_gains(
    flat: Float[np.ndarray, "frames n"], code: Code, steps: Sequence[int], saturation_dn: float
) -> Float[np.ndarray, " steps"] | None:
    """Return the gain of each step of a period, relative to the median gain; 1 for normal steps.

    Divided by its gain, each frame is mean + amplitude cos(phase - step). So the harmonics 2 to
    N - 2 of the N frames of a pixel are zero, and the sum of the frames is proportional to the
    white picture that other frames give. Both conditions are linear in the inverse gains, which
    follow from a robust least-squares fit over the pixels. A non-linear response causes harmonics,
    too, but these follow neither the mean nor the cosine.

    Returns:
        The gains; None if the pixels do not determine them.
    """
    value = flat[list(steps)]
    white, clear = _white(flat, code, steps, saturation_dn)
    clear &= value.max(axis=0) < saturation_dn
    if clear.sum() < FEWEST or (white is None and len(steps) < 4):
        return None
    value = value[:, clear]
    value = value / (value.mean(axis=0) + 1)
    rows, wanted = _equations(value)
    if white is not None:
        share = white[clear] / (flat[list(steps)][:, clear].mean(axis=0) + 1)
        rows.append(value.T / len(steps))
        wanted.append(share / np.median(share))
    weight = np.tile(_share_of_phase(value), len(rows))
    if white is None:  # Nothing then determines the mean of the inverse gains, so it is set to 1.
        rows.append(np.full((1, len(steps)), 1 / len(steps)))
        wanted.append(np.ones(1))
        weight = np.append(weight, 1.0)
    fit = _solved(np.concatenate(rows), np.concatenate(wanted), weight, value.shape[1])
    if fit.left > LEFT or (fit.inverse <= 0).any():
        return None
    excess = np.median(fit.inverse) / fit.inverse - 1
    limit = np.maximum(max(LEAST, MODEL / max(fit.condition, 1e-6)), SURE_SIGMAS * fit.sigma)
    return np.where(np.abs(excess) <= limit, 1.0, 1 + excess)


def _white(flat, code: Code, steps: Sequence[int], saturation_dn: float):
    """Return the white picture from other frames, or None, and a mask without saturated pixels."""
    groups = [g for g in (*inverse_pairs(code), *full_periods(code)) if set(g).isdisjoint(steps)]
    groups += [(k,) for k, frame in enumerate(code.frames) if frame.kind == "white"]
    clear = np.ones(flat.shape[1], dtype=bool)
    if not groups:
        return None, clear
    for group in groups:
        clear &= flat[list(group)].max(axis=0) < saturation_dn
    sums = [flat[list(group)].mean(axis=0) for group in groups]
    return np.median([s / max(float(np.median(s)), 1.0) for s in sums], axis=0), clear


def _equations(value: Float[np.ndarray, "steps n"]):
    """Return the equations for a cosine, whose harmonics are zero: rows and right-hand sides."""
    rows: list[np.ndarray] = []
    count = len(value)
    for k in range(2, count // 2 + 1):
        turn = np.exp(-2j * np.pi * k * np.arange(count) / count)[:, None] / count
        parts = [(value * turn).real, (value * turn).imag][: 1 if 2 * k == count else 2]
        rows += [part.T for part in parts]
    return rows, [np.zeros(value.shape[1]) for _ in rows]


def _share_of_phase(value: Float[np.ndarray, "steps n"]) -> Float[np.ndarray, " n"]:
    """Return weights that give all phases the same influence, although some are rarer."""
    turn = np.exp(2j * np.pi * np.arange(len(value)) / len(value))
    number = (np.angle(turn @ value) / (2 * np.pi) % 1 * BINS).astype(int) % BINS
    count = np.bincount(number, minlength=BINS)
    weight = 1 / np.maximum(count[number], 0.01 * len(number))
    return weight / weight.sum()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    inverse: Float[np.ndarray, " steps"]  # Inverse gains
    sigma: Float[np.ndarray, " steps"]
    condition: float  # Condition of the equations, 0 to 1
    left: float  # Median misfit


def _solved(rows, wanted, weight, pixels: int) -> _Fit:
    """Fit the inverse gains; each block of rows has the pixels in the same order."""
    robust = np.ones(len(wanted))
    for _ in range(ROUNDS):
        weighted = rows * (weight * robust)[:, None]
        matrix = rows.T @ weighted
        inverse = np.linalg.lstsq(matrix, wanted @ weighted, rcond=None)[0]
        off = wanted - rows @ inverse
        usual = float(np.median(np.abs(off)))
        robust = 1 / (1 + (off / (FAR * usual + 1e-9)) ** 2)
    chunk = np.arange(len(wanted)) % pixels * CHUNKS // pixels
    side = np.array([off[part] @ weighted[part] for part in (chunk == c for c in range(CHUNKS))])
    strengths = np.linalg.eigvalsh(rows.T @ (rows * weight[:, None]))
    return _Fit(
        inverse=inverse,
        sigma=np.linalg.norm(np.linalg.pinv(matrix) @ side.T, axis=1),
        condition=math.sqrt(max(float(strengths[0] / strengths[-1]), 0.0)),
        left=usual,
    )
