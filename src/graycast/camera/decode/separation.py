"""Separation of the projector's direct light from global light, which is reflected repeatedly."""

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from ...base.errors import DecodeError
from ...rig.pattern import AXES, Code
from .maps import Levels
from .plan import Period, plan_axes

NARROW_PX = 32.0  # Gray stripes of at most this period count as narrow.


def separate(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"], code: Code, levels: Levels
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return the direct and the global light of each pixel under a white picture [DN above offset].

    Under narrow stripes, half of which are lit, each point receives half of the global light `g`,
    and either its full direct light `d` or none, so frames vary from `g / 2` to `d + g / 2`. For a
    phase code these follow from mean and amplitude of the shortest period, for a Gray code from the
    extremes of the narrow stripes and their inverses. The black frame (or, without one, the offset)
    is subtracted, as light that does not come from the projector.

    Leaves out: blur. Stripes that are out of focus or finer than a camera pixel lack contrast, so
    `d` is too low and `g` too high by the same amount. Global light that itself has stripes
    (mirrors, grazing light on a nearby wall) counts as direct. Nothing is clamped: with noise, `g`
    can be below 0.

    Raises:
        DecodeError: the code has neither phases nor narrow stripes with inverses.

    Source: S. Nayar, G. Krishnan, M. Grossberg, R. Raskar, "Fast Separation of Direct and Global
    Components of a Scene using High Frequency Illumination", SIGGRAPH 2006.
    """
    black = [k for k, f in enumerate(code.frames) if f.kind == "black"]
    unlit = frames[black[0]].astype(np.float32) if black else np.float32(levels.offset_dn)
    plans = plan_axes(code, fine_bits=0)
    periods = [plan.periods[0] for plan in plans.values() if plan.periods]
    if periods:
        shortest = min(periods, key=lambda period: period.period_px)
        comb = code.frames[shortest.frames[0]].kind == "line"
        return _of_phases(frames, shortest, 1 / shortest.period_px if comb else 0.5, comb, unlit)
    return _of_stripes(frames, _narrow(code), unlit)


def _of_phases(frames, period: Period, lit: float, comb: bool, unlit):
    """Solve for d and g: mean is `lit (d + g)`, amplitude is `lit d` (twice that for a comb)."""
    mean, c, s = np.zeros((3, *frames.shape[1:]), dtype=np.float32)
    for k, delta in zip(period.frames, period.delta_rad, strict=True):
        mean += frames[k]
        c += np.float32(np.cos(delta)) * frames[k]
        s += np.float32(np.sin(delta)) * frames[k]
    count = len(period.frames)
    amplitude = np.float32(2 / count) * np.hypot(c, s)
    direct = amplitude / np.float32(2 * lit if comb else lit)
    return direct, (mean / np.float32(count) - unlit) / np.float32(lit) - direct


def _of_stripes(frames, narrow: list[int], unlit):
    high = frames[narrow].max(axis=0).astype(np.float32)
    low = frames[narrow].min(axis=0).astype(np.float32)
    return high - low, 2 * (low - unlit)


def _narrow(code: Code) -> list[int]:
    """Return the frames of narrow stripes that have an inverse, so each pixel is lit in one."""
    narrow = []
    bits = {(f.axis, f.bit, f.inverse) for f in code.frames if f.kind == "gray"}
    for k, frame in enumerate(code.frames):
        if frame.kind != "gray" or (frame.axis, frame.bit, not frame.inverse) not in bits:
            continue
        finest = frame.bit if frame.xor_bit < 0 else min(frame.bit, frame.xor_bit)
        if 4 * 2**finest * code.stride_px[AXES.index(frame.axis)] <= NARROW_PX:
            narrow.append(k)
    if not narrow:
        raise DecodeError(
            "direct and global light need phases, or stripes with a period of at most "
            f"{NARROW_PX:g} px with their inverses; the code has neither"
        )
    return narrow
