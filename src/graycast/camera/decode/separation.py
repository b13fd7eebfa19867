"""Separation of the projector's direct light from global light, which is reflected repeatedly."""

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from ...base.errors import DecodeError
from ...rig.pattern import Code
from .maps import Levels
from .plan import Period, plan_axes

NARROW_PX = 32.0  # Stripes with at most this period count as narrow.


def separate(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"], code: Code, levels: Levels
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return the direct and the global light of each pixel under a white picture [DN above offset].

    Under narrow stripes, half of which are lit, each point receives half of the global light `g`,
    and either its full direct light `d` or none, so frames vary from `g / 2` to `d + g / 2`. For a
    phase code these follow from mean and amplitude of the shortest period, for a Gray code from the
    extremes of the narrow stripes and their inverses. Without inverses, white plus black is the sum
    of a frame and its inverse, so their difference `d` is twice the frame minus this sum. The mean
    of the larger half of these differences is less biased by noise than the largest one. The black
    frame (or, without one, the offset) is subtracted, as light that does not come from the
    projector.

    Leaves out: blur. Stripes that are out of focus or finer than a camera pixel lack contrast, so
    `d` is too low and `g` too high by the same amount. Global light that itself has stripes
    (mirrors, grazing light on a nearby wall) counts as direct. Nothing is clamped: with noise, `g`
    can be below 0.

    Raises:
        DecodeError: the code has no phases, and no narrow stripes with inverses or with white and
            black frames.

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
    paired, alone = _narrow(code)
    return _of_stripes(frames, paired, unlit) if paired else _of_lone_stripes(frames, alone, code)


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


def _of_lone_stripes(frames, narrow: list[int], code: Code):
    white, black = _single(frames, code, "white"), _single(frames, code, "black")
    contrast = np.abs(2 * frames[narrow].astype(np.float32) - white - black)
    direct = np.sort(contrast, axis=0)[len(narrow) // 2 :].mean(axis=0)
    return direct, white - black - direct


def _single(frames, code: Code, kind: str) -> Float[np.ndarray, "h w"]:
    (place,) = [k for k, frame in enumerate(code.frames) if frame.kind == kind]
    return frames[place].astype(np.float32)


def _narrow(code: Code) -> tuple[list[int], list[int]]:
    """Return the frames of narrow stripes with an inverse, and the least narrow without inverse.

    With inverses, each pixel is lit in one of two frames. Without them, the stripes of the largest
    narrow period and of half of it count, because blur costs them least.
    """
    bits = {(f.axis, f.bit, f.inverse) for f in code.frames if f.kind == "gray"}
    paired: list[int] = []
    alone: dict[int, float] = {}
    for k, frame in enumerate(code.frames):
        if frame.kind != "gray":
            continue
        period_px = code.stripe_px(frame)
        if period_px > NARROW_PX:
            continue
        if (frame.axis, frame.bit, not frame.inverse) in bits:
            paired.append(k)
        else:
            alone[k] = period_px
    kinds = {frame.kind for frame in code.frames}
    if not paired and not (alone and {"white", "black"} <= kinds):
        raise DecodeError(
            "direct and global light need phases, or stripes with a period of at most "
            f"{NARROW_PX:g} px with their inverses or with white and black frames; the code has "
            "neither"
        )
    widest_px = max(alone.values(), default=0.0)
    return paired, [k for k, period_px in alone.items() if period_px >= widest_px / 2]
