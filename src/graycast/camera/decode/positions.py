"""From a stack of pictures to projector positions: all frames in one pass over the pixels.

`tests/camera/decode/plain_decoder.py` says the same in NumPy, frame by frame. Here every loop runs
along a row of pixels over few arrays, without branches, so that the compiler makes SIMD code of it.
Each step is a kernel of its own, compiled when a code first needs it.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Bool, Float32, UInt8, UInt16

from ...base.errors import DecodeError
from ...base.kernels import kernel
from ...rig.pattern import AXES, Axis, Code
from .bits import FINE_ERROR, GrayBits, Light, Places, lose_bits, read_gray
from .maps import CodeMap, DecodeSpec, Levels, Mark, Reason
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
from .settling import CHOICES, CLEAR, OPEN, Pixels, settle, settle_refused

SHADOW_SIGMAS = 6.0  # The range of some twenty noisy frames of equal light seldom exceeds it.


def decode(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    spec: DecodeSpec,
    levels: Levels,
    *,
    fine_error: float = FINE_ERROR,
) -> CodeMap:
    """Read a stack.

    A Gray bit is the sign of pattern minus inverse; without inverse it tells whether the pixel is
    above the middle of its own darkest and brightest frame, as in K. Bai et al. 2024. Phases are
    counted by the Gray code or by one another; the place is their mean, weighted by their noise.
    docs/explanation/decoding.md, "Bits" and "Phases".

    Leaves out: what the projector's square pixels do to a camera that resolves them. A cosine or a
    comb on a grid of pixels is a staircase, of however many pixels a line is made. Its error (peak,
    projector px) for a camera pixel that covers 1 or 1.5 of them, and a projector blurred to a disc
    of some radius, is far under `sigma` once stripes are blurred by a pixel:

        period 8 px   sharp 0.010, 0.075   0.5 px  0.007, 0.014   1 px  0.004, 0.005
        period 16 px  sharp 0.003, 0.081   0.5 px  0.002, 0.013   1 px  0.001, 0.005

    Args:
        fine_error: by how much a fine bit's signal is off beyond its noise, as a share of the
            pixel's contrast; it widens `sigma` alone. 0 leaves noise, as if each bit were wrong by
            itself.

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
    stack.flags.writeable = False  # kernels are compiled for each kind of array: this is one
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
    """A stack, and what is known of each pixel; `strength`, `why` and `mark` are written to."""

    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"]
    law: tuple[np.float32, ...]  # offset_dn, floor_dn2, slope_dn
    # Shows too little: min_contrast [DN], min_sigmas, min_visibility.
    dark: tuple[np.float32, np.float32, np.float32]
    votes: int  # of neighbours that settle the period of a contradictory pixel; 0 is none
    saturation_dn: np.float32
    light: Light
    top: Bool[np.ndarray, "h w"]  # a frame that is read is at the top
    strength: Float32[np.ndarray, "h w"]
    why: UInt8[np.ndarray, "h w"]
    mark: UInt8[np.ndarray, "h w"]


def _cues(frames, plans: dict[Axis, AxisPlan], spec: DecodeSpec, levels: Levels) -> _Cues:
    """Brightest and darkest value of each pixel, and where the top is reached."""
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
    """Places and their standard deviations along one axis; `Reason`s go to `cues.why`."""
    shape = cues.why.shape
    place = np.empty(shape, dtype=np.float32)
    # Only a phase asks for rivals; without one they may go where the place will be written.
    rival = np.zeros(shape, dtype=np.float32) if plan.periods else place
    places = Places(place=place, sigma=np.zeros(shape, dtype=np.float32), rival=rival)
    clipped = bool(cues.top.any())
    free = cues.why == Reason.DECODED if cues.votes else None  # of what another axis says
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
    """Count periods by the phases themselves; what they leave open is the neighbours' to settle.

    `by_gray`: a Gray code says about where, so a pixel whose phases do not agree there has light
    from elsewhere.
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
    """Each pixel's reason so far, by its light as well as by its code."""
    reason = cues.why.copy()
    _judge(cues.light, cues.strength, cues.top, reason, cues.law, cues.dark)
    return reason


def _settle_refused(cues: _Cues, period_px: float, turn, free, place) -> None:
    """Give pixels whose bits contradict each other the period that their neighbours lead to."""
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
    """Brightest and darkest value of each pixel [DN], and their difference; each row's highest."""
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
    """Where one of the frames that are read is at the top."""
    for y in numba.prange(len(top)):
        if peak[y] < saturation_dn:
            continue
        for k in read:
            frame = stack[k, y]
            for x in range(len(frame)):
                top[y, x] |= np.float32(frame[x]) >= saturation_dn


@kernel(parallel=True, error_model="numpy")
def _judge(light, strength, top, why, law, dark):
    """What is wrong with a pixel's light goes before what is wrong with its code.

    Whatever it is, it was found in frames that do not say all where one is at the top.
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
        reason[x] = 2 if strength[x] * strength[x] < sigmas * sigmas * noise2 else reason[x]
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
