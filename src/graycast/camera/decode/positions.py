"""From a stack of pictures to projector positions: all frames in one pass over the pixels.

`tests/camera/decode/plain_decoder.py` has the same computation in NumPy, frame by frame. Here every
loop runs along a row of pixels over few arrays and without branches, so that it compiles to SIMD
code. Each step is a separate kernel, which is compiled when a code first needs it.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Bool, Float32, UInt8, UInt16

from ...base import array_types as arrays
from ...base.errors import DecodeError
from ...base.kernels import kernel
from ...rig.pattern import AXES, Axis, Code
from .bits import FINE_ERROR, GrayBits, Light, Places, lose_bits, read_gray
from .maps import CodeMap, DecodeSpec, Levels, Mark
from .phases import (
    MIN_LEAD,
    Phases,
    bound,
    count_by_gray,
    count_by_phases,
    fuse,
    lose_phases,
    open_choices,
    read_phases,
)
from .plan import AxisPlan, plan_axes, read_frames
from .reasons import Reason
from .settling import CHOICES, CLEAR, OPEN, Pixels, settle, settle_refused

SHADOW_SIGMAS = 6.0  # The range of about twenty frames of equal light seldom exceeds this.
LOW_MODULATION = int(Reason.LOW_MODULATION)  # As a plain number it keeps the loop a tenth faster.


def decode(
    frames: arrays.UInt8or16Array_n_h_w,
    code: Code,
    spec: DecodeSpec,
    levels: Levels,
    *,
    fine_error: float = FINE_ERROR,
) -> CodeMap:
    """Decode a stack to the projector position of each camera pixel.

    A Gray bit is the sign of pattern minus inverse. Without an inverse, the threshold is the mean
    of the pixel's darkest and brightest frame, as in K. Bai et al. 2024. Periods are counted by the
    Gray code or by other phases; the position is the mean of the phases, weighted by noise. See
    docs/explanation/decoding.md, "Bits" and "Phases".

    Leaves out: the square pixels of the projector. A cosine or a comb of lines on a grid of pixels
    is a staircase. The table has its peak error [projector px] if a camera pixel covers 1 or 1.5
    projector pixels, for several radii of blur; with a radius of one pixel it is far below `sigma`:

        period 8 px   sharp 0.010, 0.075   0.5 px  0.007, 0.014   1 px  0.004, 0.005
        period 16 px  sharp 0.003, 0.081   0.5 px  0.002, 0.013   1 px  0.001, 0.005

    Args:
        fine_error: error of a fine bit's signal in addition to its noise, as a share of the
            pixel's contrast. It only widens `sigma`. With 0, only independent noise counts.

    Raises:
        DecodeError: the stack has another number of frames than the code, or frames are missing.
    """
    if len(frames) != len(code.frames):
        raise DecodeError(
            f"the stack has {len(frames)} frames, the code has {len(code.frames)}: check the "
            "projector size and the inverse frames"
        )
    plans = plan_axes(code, spec.fine_bits)
    stack = np.ascontiguousarray(frames).view()
    stack.flags.writeable = False  # Numba compiles a kernel once if all arrays are read-only.
    cues = _cues(stack, plans, spec, levels)
    places = {axis: _read(cues, plan, spec, fine_error) for axis, plan in plans.items()}
    why, strength = cues.why, cues.strength
    _judge(cues.light, strength, cues.top, why, cues.law, cues.dark)
    for place, sigma in places.values():
        _forget(why, place, sigma)
    strength /= np.float32(levels.range_dn)
    column, row = (
        places[axis] if axis in places else np.full((2, *why.shape), np.nan, dtype=np.float32)
        for axis in AXES
    )
    return CodeMap(
        column=column[0],
        row=row[0],
        sigma_column=column[1],
        sigma_row=row[1],
        modulation=strength,
        reason=why,
        mark=cues.mark,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cues:
    """A stack, and maps of its pixels; the decoder writes to `strength`, `why` and `mark`."""

    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"]
    law: tuple[np.float32, ...]  # offset_dn, floor_dn2, slope_dn
    # Limits of contrast: min_contrast [DN], min_sigmas, min_visibility.
    dark: tuple[np.float32, np.float32, np.float32]
    votes: int  # Votes that settle the period of a contradictory pixel; 0 switches this off.
    saturation_dn: np.float32
    light: Light
    top: Bool[np.ndarray, "h w"]  # Pixels with saturation in a frame that determines the position
    strength: Float32[np.ndarray, "h w"]
    why: UInt8[np.ndarray, "h w"]
    mark: UInt8[np.ndarray, "h w"]


def _cues(frames, plans: dict[Axis, AxisPlan], spec: DecodeSpec, levels: Levels) -> _Cues:
    """Return the brightest and darkest value of each pixel, and the saturated pixels."""
    shape = frames.shape[1:]
    high, low, strength = (np.empty(shape, dtype=np.float32) for _ in range(3))
    numbers = (levels.offset_dn, levels.floor_dn2, levels.slope_dn)
    saturation_dn = np.float32(levels.saturation_dn)
    peak = np.empty(shape[0], dtype=np.float32)
    _range(frames, high, low, strength, peak)
    top = np.zeros(shape, dtype=np.bool_)
    if peak.max(initial=0) >= saturation_dn:
        read = np.flatnonzero(read_frames(plans, len(frames)))
        _reach(frames, read, peak, saturation_dn, top)
    return _Cues(
        frames=frames,
        law=tuple(np.float32(number) for number in numbers),
        dark=(
            np.float32(spec.min_contrast * levels.range_dn),
            np.float32(spec.min_sigmas),
            np.float32(spec.min_visibility),
        ),
        votes=spec.settling_votes,
        saturation_dn=saturation_dn,
        light=Light(high, low),
        top=top,
        strength=strength,
        why=np.zeros(shape, dtype=np.uint8),
        mark=top.view(np.uint8) * np.uint8(Mark.CLIPPED),
    )


def _read(cues: _Cues, plan: AxisPlan, spec: DecodeSpec, fine_error: float) -> tuple:
    """Return positions and standard deviations along one axis; write reasons to `cues.why`."""
    shape = cues.why.shape
    place = np.empty(shape, dtype=np.float32)
    # Only phases need rivals. Without phases, `place` serves as memory and is overwritten later.
    rival = np.zeros(shape, dtype=np.float32) if plan.periods else place
    places = Places(place=place, sigma=np.zeros(shape, dtype=np.float32), rival=rival)
    clipped = bool(cues.top.any())
    free = cues.why == Reason.DECODED if cues.votes else None  # No axis has refused these yet.
    if plan.bits:
        bits = np.array([(b.frame, b.inverse, b.xor, b.counts) for b in plan.bits])
        numbers = (plan.first_px, plan.cell_px, plan.reach, spec.doubt, fine_error)
        gray = GrayBits(bits, *map(np.float32, numbers))
        if clipped:
            lose_bits(cues.frames, bits, cues.light, cues.top, cues.saturation_dn, cues.why)
        read_gray(cues.frames, gray, cues.law, cues.light, places, cues.why)
    if plan.periods:
        _read_phases(cues, plan, clipped, free, places)
    else:
        _within_cell(np.float32(plan.cell_px**2 / 12), places.sigma)
    _outside(np.float32(plan.size_px), place, cues.why)
    return place, places.sigma


def _read_phases(cues: _Cues, plan: AxisPlan, clipped: bool, free, places: Places) -> None:
    place, sigma, rival = places
    counts = [len(p.frames) for p in plan.periods]
    starts = np.cumsum([0, *counts[:-1]])
    lengths = [p.period_px for p in plan.periods]
    model2 = np.full(len(counts), plan.model_rad**2)
    periods = np.column_stack([lengths, starts, counts, model2]).astype(np.float64)
    index = np.array([k for p in plan.periods for k in p.frames])
    delta = np.array([d for p in plan.periods for d in p.delta_rad])
    waves = np.array([f(m * delta) for m in (1, 2) for f in (np.cos, np.sin)], np.float32).T
    h, w = cues.why.shape
    turn, noise2 = np.empty((2, h, len(counts), w), dtype=np.float32)
    if clipped:
        lose_phases(cues.frames, index, cues.top, cues.saturation_dn, cues.why)
    read_phases(cues.frames, periods, index, waves, cues.law, cues.strength, turn, noise2)
    if plan.gray_counts:
        count_by_gray(periods, np.float32(plan.cell_px), turn, place, sigma, rival, cues.why)
        if cues.votes:
            _settle_refused(cues, periods[0, 0], turn[:, 0], free, place)
    else:
        if not plan.bits:
            place[:] = 0.5 * (plan.size_px - 1)
        bounds = np.empty((h, 2, w), dtype=np.float32)
        phases = Phases(periods, delta, plan.half_px, bounds, turn, noise2)
        bound(phases, place)
        _count(cues, phases, place, bool(plan.bits))
    fuse(periods, turn, noise2, place, sigma)


def _count(cues: _Cues, phases: Phases, place, by_gray: bool) -> None:
    """Count periods with the phases alone; neighbours settle the counts that remain open.

    `by_gray` is true if a Gray code gives a coarse position. Phases that do not fit this position
    are a sign of indirect light; without it, phases that do not fit are a contradiction.
    """
    state = np.empty(place.shape, dtype=np.uint8)
    count_by_phases(phases, place, state)
    lit = _reasons_so_far(cues) == Reason.DECODED
    if (lit & (state == OPEN)).any():
        h, w = place.shape
        choice = np.empty((h, CHOICES, w), dtype=np.int32)
        cost = np.empty(choice.shape, dtype=np.float32)
        open_choices(phases, state, choice, cost)
        first, period = np.ascontiguousarray(phases.turn[:, 0]), np.float32(phases.periods[0, 0])
        count = np.full(place.shape, -1, dtype=np.int32)
        pixels = Pixels(first, choice, cost, state, lit, count)
        settled = settle(pixels, place, period, min_lead=MIN_LEAD)
        cues.mark[settled] |= np.uint8(Mark.SETTLED)
    wrong = Reason.INTERREFLECTION if by_gray else Reason.CONTRADICTORY
    cues.why[(state != CLEAR) & (cues.why == Reason.DECODED)] = wrong


def _reasons_so_far(cues: _Cues) -> UInt8[np.ndarray, "h w"]:
    """Return each pixel's reason after the checks of its light and its code."""
    reason = cues.why.copy()
    _judge(cues.light, cues.strength, cues.top, reason, cues.law, cues.dark)
    return reason


def _settle_refused(cues: _Cues, period_px: float, turn, free, place) -> None:
    """Give pixels with contradictory bits the period that their neighbours agree on."""
    reason = _reasons_so_far(cues)
    refused = free & ((reason == Reason.CONTRADICTORY) | (reason == Reason.INTERREFLECTION))
    if refused.any():
        clear = reason == Reason.DECODED
        settled = settle_refused(
            period_px, np.ascontiguousarray(turn), place, refused, clear, votes=cues.votes
        )
        cues.mark[settled] |= np.uint8(Mark.SETTLED)
        cues.why[settled] = Reason.DECODED


@kernel(parallel=True, error_model="numpy")
def _range(stack, high, low, strength, peak):
    """Write the extremes of each pixel [DN], their difference, and the maximum of each row."""
    for y in numba.prange(stack.shape[1]):
        peak[y] = _range_row(stack, np.int64(y), high[y], low[y], strength[y])


@kernel()
def _range_row(stack, y, high, low, strength):
    most = stack[0, y].copy()
    least = stack[0, y].copy()
    for k in range(1, len(stack)):
        frame = stack[k, y]
        for x in range(len(most)):
            most[x] = max(most[x], frame[x])
            least[x] = min(least[x], frame[x])
    for x in range(len(most)):
        high[x] = most[x]
        low[x] = least[x]
        strength[x] = np.float32(most[x]) - np.float32(least[x])
    highest = most[0]
    for x in range(len(most)):
        highest = max(highest, most[x])
    return highest


@kernel(parallel=True)
def _reach(stack, read, peak, saturation_dn, top):
    """Mark pixels where one of the frames that determine positions is saturated."""
    for y in numba.prange(len(top)):
        if peak[y] < saturation_dn:
            continue
        for k in read:
            frame = stack[k, y]
            for x in range(len(frame)):
                top[y, x] |= np.float32(frame[x]) >= saturation_dn


@kernel(parallel=True, error_model="numpy")
def _judge(light, strength, top, why, law, dark):
    """Write the reasons that follow from a pixel's light, which replace reasons of its code.

    If one of the pixel's frames is saturated, SATURATED replaces any other reason.
    """
    high, low = light.high, light.low
    for y in numba.prange(len(high)):
        _judge_row(high[y], low[y], strength[y], top[y], why[y], law, dark)


@kernel(error_model="numpy")
def _judge_row(high, low, strength, top, why, law, dark):
    offset_dn, floor_dn2, slope_dn = law
    dark_dn, sigmas, visibility = dark
    shadow2, zero = np.float32(SHADOW_SIGMAS**2), np.float32(0)
    reason = why.astype(np.int32)
    for x in range(len(why) if visibility > zero else 0):
        mixed = (reason[x] == Reason.DECODED) & (strength[x] < visibility * (high[x] - low[x]))
        reason[x] = np.int32(Reason.INTERREFLECTION) if mixed else reason[x]
    for x in range(len(why)):
        reason[x] = reason[x] if strength[x] >= dark_dn else np.int32(Reason.LOW_MODULATION)
    for x in range(len(why)):
        noise2 = floor_dn2 + slope_dn * max(low[x] - offset_dn, zero)
        dim = strength[x] * strength[x] < sigmas * sigmas * noise2
        reason[x] = LOW_MODULATION if dim else reason[x]
        contrast = high[x] - low[x]
        unlit = contrast * contrast < shadow2 * noise2
        reason[x] = np.int32(Reason.SHADOW) if unlit else reason[x]
    for x in range(len(why)):
        lost = top[x] & (reason[x] != Reason.DECODED)
        reason[x] = np.int32(Reason.SATURATED) if lost else reason[x]
    for x in range(len(why)):
        why[x] = reason[x]


@kernel(parallel=True)
def _forget(why, place, sigma):
    nan = np.float32(np.nan)
    for y in numba.prange(len(why)):
        for x in range(why.shape[1]):
            decoded = why[y, x] == Reason.DECODED
            place[y, x] = place[y, x] if decoded else nan
            sigma[y, x] = sigma[y, x] if decoded else nan


@kernel(parallel=True)
def _outside(size_px, place, why):
    border, end = np.float32(-0.5), size_px - np.float32(0.5)
    for y in numba.prange(len(why)):
        for x in range(why.shape[1]):
            outside = (place[y, x] < border) | (place[y, x] > end)
            outside &= why[y, x] == Reason.DECODED
            why[y, x] = np.uint8(Reason.OUTSIDE_PROJECTOR) if outside else why[y, x]


@kernel(parallel=True)
def _within_cell(cell_variance_px2, sigma):
    for y in numba.prange(len(sigma)):
        for x in range(sigma.shape[1]):
            sigma[y, x] = math.sqrt(sigma[y, x] + cell_variance_px2)
