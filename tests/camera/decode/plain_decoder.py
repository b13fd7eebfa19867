"""A slow `decode` in NumPy, frame by frame, with which tests compare the fast one."""

from itertools import product

import numpy as np
from jaxtyping import UInt8, UInt16

from graycast.camera.decode.bits import BLURRED, FINE_ERROR, SHARP, XOR_DOUBT, XOR_SIGMAS
from graycast.camera.decode.maps import CodeMap, DecodeSpec, Levels, Mark
from graycast.camera.decode.phases import (
    APART_SIGMAS,
    MAX_MISFIT,
    MIN_LEAD,
    SLACK_SIGMAS,
    USUAL_SIGMAS,
)
from graycast.camera.decode.plan import (
    MODEL_RAD,
    OFF_CELL,
    AxisPlan,
    Period,
    plan_axes,
    read_frames,
)
from graycast.camera.decode.positions import SHADOW_SIGMAS
from graycast.camera.decode.reasons import Reason
from graycast.camera.decode.settling import (
    AGAINST_SHARE,
    CHOICES,
    CLEAR,
    MAX_AGAINST,
    MIN_NEIGHBOURS,
    MOST_AGAINST,
    OPEN,
    PASSES,
    REACH_PX,
    REFUSED,
    STEP_PERIODS,
)
from graycast.rig.pattern import AXES, Code


def decode_plain(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    spec: DecodeSpec,
    levels: Levels,
    *,
    fine_error: float = FINE_ERROR,
) -> CodeMap:
    """Do the same as `decode`, slowly."""
    stack = frames.astype(np.float64)
    high, low = stack.max(axis=0), stack.min(axis=0)
    strength = high - low
    why = np.zeros(high.shape, dtype=np.uint8)
    by_axis = {}
    plans = plan_axes(code, spec.fine_bits)
    full = stack >= levels.saturation_dn
    top = full[read_frames(plans, len(frames))].any(axis=0)
    mark = np.where(top, int(Mark.CLIPPED), 0)
    for axis, plan in plans.items():
        place, sigma = np.full(high.shape, np.nan), np.full(high.shape, np.nan)
        coarse = variance = rival = None
        free = why == Reason.DECODED
        _say(why, _lost(stack, full, plan, high + low, levels), Reason.SATURATED)
        if plan.bits:
            coarse, variance, rival, doubts = _gray(
                stack, plan, spec, levels, high, low, fine_error
            )
            contradiction = np.where(doubts[1] == 0, Reason.INTERREFLECTION, Reason.CONTRADICTORY)
            _say(why, doubts.sum(axis=0) >= 2, contradiction)
            place, sigma = coarse, np.sqrt(variance + plan.cell_px**2 / 12)
        if plan.periods:

            def reason_of(amplitude, wrong=False, strength=strength):
                reasons = why.copy()
                _say(reasons, wrong, Reason.INTERREFLECTION)
                weakest = np.minimum(strength, 2 * amplitude)
                return _judge(reasons, high, low, weakest, top, spec, levels)

            place, sigma, amplitude, wrong, by_others = _phase(
                stack, plan, levels, coarse, variance, rival, reason_of, free, spec.settling_votes
            )
            strength = np.minimum(strength, 2 * amplitude)
            mark[by_others] |= Mark.SETTLED
            why[by_others] = Reason.DECODED
            _say(why, wrong, Reason.INTERREFLECTION if plan.bits else Reason.CONTRADICTORY)
        _say(why, (place < -0.5) | (place > plan.size_px - 0.5), Reason.OUTSIDE_PROJECTOR)
        by_axis[axis] = place, sigma
    reason = _judge(why, high, low, strength, top, spec, levels)
    maps = []
    for axis in AXES:
        for values in by_axis.get(axis, (np.full(high.shape, np.nan),) * 2):
            maps.append(np.where(reason == Reason.DECODED, values, np.nan).astype(np.float32))
    return CodeMap(
        column=maps[0],
        row=maps[2],
        sigma_column=maps[1],
        sigma_row=maps[3],
        modulation=(strength / levels.range_dn).astype(np.float32),
        reason=reason,
        mark=mark.astype(np.uint8),
    )


def _say(why, where, reason) -> None:
    """Give a pixel the first reason that applies."""
    first = where & (why == 0)
    why[first] = np.broadcast_to(reason, why.shape)[first]


def _judge(why, high, low, strength, top, spec: DecodeSpec, levels: Levels):
    """Give each pixel a reason; reasons of its light come before reasons of its code."""
    noise_dn2 = levels.floor_dn2 + levels.slope_dn * np.maximum(low - levels.offset_dn, 0)
    least = np.float32(spec.min_visibility) * (high - low).astype(np.float32)
    mixed = (why == Reason.DECODED) & (strength.astype(np.float32) < least)
    why = np.where(mixed, Reason.INTERREFLECTION, why)
    reason = np.select(
        [
            high - low < SHADOW_SIGMAS * np.sqrt(noise_dn2),
            (strength < spec.min_contrast * levels.range_dn)
            | (strength < spec.min_sigmas * np.sqrt(noise_dn2)),
        ],
        [Reason.SHADOW, Reason.LOW_MODULATION],
        why,
    ).astype(np.uint8)
    reason[top & (reason != Reason.DECODED)] = Reason.SATURATED
    return reason


def _lost(stack, full, plan: AxisPlan, twice_threshold, levels: Levels):
    """Return pixels with a saturated frame of a phase, or bit with its inverse or threshold."""
    lost = np.zeros(twice_threshold.shape, dtype=bool)
    alone = [bit for bit in plan.bits if bit.inverse < 0]
    glare = full[[bit.frame for bit in alone]].any(axis=0)
    for bit in plan.bits:
        if bit.inverse >= 0:
            lost |= full[bit.frame] & full[bit.inverse]
        else:
            lost |= full[bit.frame] & (twice_threshold >= 2 * levels.saturation_dn)
            narrow = bit.counts != 1 or bit.xor >= 0
            lost |= narrow & glare & (2 * stack[bit.frame] > twice_threshold)
    for period in plan.periods:
        lost |= full[list(period.frames)].any(axis=0)
    return lost


def _gray(stack, plan: AxisPlan, spec: DecodeSpec, levels: Levels, high, low, fine_error):
    middle = high + low
    noise_dn2 = 2 * levels.floor_dn2 + levels.slope_dn * np.maximum(
        middle - 2 * levels.offset_dn, 0
    )
    margins, noises, bits = [], [], []
    for bit in plan.bits:
        if bit.inverse >= 0:
            margin, noise = stack[bit.frame] - stack[bit.inverse], np.sqrt(noise_dn2)
        else:
            margin, noise = 2 * stack[bit.frame] - middle, np.sqrt(3 * noise_dn2)
        margins.append(margin)
        noises.append(noise)
        bits.append(margin > 0)
    bits = [
        b ^ bits[bit.xor] if bit.xor >= 0 else b for b, bit in zip(bits, plan.bits, strict=True)
    ]
    value, last = np.zeros(high.shape, dtype=int), np.zeros(high.shape, dtype=bool)
    for b in bits:
        last = last ^ b
        value = 2 * value + last

    variance, rival = np.zeros(high.shape), np.zeros(high.shape)
    doubts = np.zeros((2, *high.shape), dtype=int)
    counted = [b for b, bit in enumerate(plan.bits) if bit.counts == 1]
    for b, bit in enumerate(plan.bits):
        flipped = value ^ (2 ** (len(bits) - b) - 1)
        error, square = noises[b], (flipped - value) ** 2
        if fine_error > 0 and not bit.counts and bit.xor < 0:
            error = np.hypot(error, fine_error * (high - low))
            sharp = 1.0
            if b > 0 and plan.bits[b - 1].xor < 0:
                with np.errstate(divide="ignore", invalid="ignore"):
                    beside = np.abs(margins[b - 1]) / (high - low)
                sharp = np.clip((beside - BLURRED) / (SHARP - BLURRED), 0, 1)
            square = square - sharp * (square / 2 + 1 / 6)
        probability = 0.5 * np.maximum(1 - np.abs(margins[b]) / error / 3, 0) ** 3
        variance += probability * square
        if bit.counts:
            # In float32, as in the fast decoder, because a signal may be exactly at the limit.
            costly = np.abs(flipped - value) > plan.reach
            doubt = np.full(high.shape, np.float32(spec.doubt))
            if bit.xor >= 0:
                doubt = np.where(costly, np.float32(XOR_DOUBT) * doubt, np.float32(0))
            limit = doubt * (high - low).astype(np.float32)
            if bit.xor >= 0 or bit.counts > 1:
                noise = np.float32(XOR_SIGMAS) * noises[b].astype(np.float32)
                limit = np.maximum(limit, noise)
            doubtful = np.abs(margins[b]) < limit
            half = 0 if 2 * sum(c < b for c in counted) < len(counted) else 1
            grave = 1 + costly
            doubts[half] += doubtful * np.maximum(grave, bit.counts)
            rival = np.where(doubtful, plan.cell_px * (flipped - value), rival)
    coarse = plan.first_px + plan.cell_px * (value + 0.5)
    return coarse, plan.cell_px**2 * variance, rival, doubts


@np.errstate(divide="ignore", invalid="ignore")
def _phase(stack, plan: AxisPlan, levels: Levels, coarse, variance, rival, reason_of, free, votes):
    mean, amplitude, turn, noise2, light = _first_phase(stack, plan.periods[0], levels)
    first, settled = plan.periods[0].period_px, np.zeros(turn.shape, dtype=bool)
    others = [_first_phase(stack, p, levels) if p.full else None for p in plan.periods[1:]]
    if plan.gray_counts:
        k = np.floor(coarse / first - turn + 0.5)
        far = 0.5 * plan.cell_px + OFF_CELL * first + 2 * np.sqrt(variance)
        wrong = np.abs((k + turn) * first - coarse) > far
        wrong |= np.floor((coarse + rival) / first - turn + 0.5) != k
        if votes:
            reasons = reason_of(amplitude, wrong)
            refused = free & np.isin(reasons, [Reason.CONTRADICTORY, Reason.INTERREFLECTION])
            k, settled = _vote(turn, k, refused, reasons == Reason.DECODED, votes)
            wrong &= ~settled
    else:
        slack = np.minimum(SLACK_SIGMAS * np.sqrt(noise2), np.pi) * first / (2 * np.pi)
        middle = coarse if plan.bits else 0.5 * (plan.size_px - 1)
        bounds = middle - plan.half_px - slack, middle + plan.half_px + slack
        choice, cost, state = _count(
            stack, plan, turn, noise2, others, mean, amplitude, light, bounds
        )
        k, settled, wrong = _settle(
            turn, choice, cost, state, reason_of(amplitude) == Reason.DECODED
        )
    u = (k + turn) * first
    weight = (2 * np.pi / first) ** 2 / noise2
    summed, beyond = weight * u, np.zeros(u.shape)
    for period, other in zip(plan.periods[1:], others, strict=True):
        if other is None:
            continue
        apart = u / period.period_px - other[2]
        apart -= np.floor(apart + 0.5)
        noise2_of_both = other[3] + noise2 + MODEL_RAD**2
        agrees = (2 * np.pi * apart) ** 2 <= APART_SIGMAS**2 * noise2_of_both
        w = np.where(agrees, (2 * np.pi / period.period_px) ** 2 / other[3], 0)
        weight = weight + w
        summed = summed + w * (u - apart * period.period_px)
        noise_px2 = (other[3] * period.period_px**2 + noise2 * first**2) / (2 * np.pi) ** 2
        off_px2 = (apart * period.period_px) ** 2 - USUAL_SIGMAS**2 * noise_px2
        beyond = np.maximum(beyond, off_px2 / (1 + (period.period_px / first) ** 2))
    return summed / weight, np.sqrt(1 / weight + beyond), amplitude, wrong, settled


@np.errstate(divide="ignore", invalid="ignore")
def _first_phase(stack, period: Period, levels: Levels):
    """Return mean, amplitude, phase in periods, its variance [rad^2], a frame's variance [DN^2]."""
    frames, delta = stack[list(period.frames)], np.array(period.delta_rad)
    z = np.tensordot(np.exp(1j * delta), frames, axes=1)
    mean, amplitude = frames.mean(axis=0), 2 / len(frames) * np.abs(z)
    light = np.maximum(mean - levels.offset_dn, 0)
    steep = np.sin(np.angle(z) - delta[:, None, None]) ** 2
    shot = ((light + frames - mean) * steep).sum(axis=0)
    spread = 0.5 * len(frames) * levels.floor_dn2 + levels.slope_dn * np.maximum(shot, 0)
    dn2 = levels.floor_dn2 + levels.slope_dn * light
    return mean, amplitude, np.angle(z) / (2 * np.pi), spread / np.abs(z) ** 2, dn2


@np.errstate(divide="ignore", invalid="ignore")
def _count(stack, plan: AxisPlan, turn, noise2, others, mean, amplitude, light, bounds):
    first = plan.periods[0].period_px
    costs = []
    for k in range(int(np.nanmax(bounds[1]) / first) + 2):
        u = (k + turn) * first
        cost = np.zeros(u.shape)
        for period, other in zip(plan.periods[1:], others, strict=True):
            if other is None:
                level = (stack[period.frames[0]] - mean) / amplitude
                wave = np.cos(2 * np.pi * u / period.period_px - period.delta_rad[0])
                cost += (level - wave) ** 2 / (2 * light / amplitude**2 + plan.model_rad**2)
            else:
                apart = u / period.period_px - other[2]
                apart = 2 * np.pi * (apart - np.floor(apart + 0.5))
                cost += apart**2 / (other[3] + noise2 + plan.model_rad**2)
        cost[(u < bounds[0]) | (u > bounds[1])] = np.inf
        costs.append(cost)
    every = np.array(costs)
    ordered = np.sort(every, axis=0)
    state = np.full(ordered[0].shape, CLEAR)
    state[~(ordered[1] - ordered[0] >= MIN_LEAD)] = OPEN
    state[~(ordered[0] <= MAX_MISFIT * len(others))] = REFUSED
    choice = every.argsort(axis=0, kind="stable")[:CHOICES]
    return choice, np.take_along_axis(every, choice, axis=0), state


def _settle(turn, choice, cost, state, lit):
    """Do the same as `settling.settle`: return periods, and the settled pixels."""
    was_open = state == OPEN
    state, k = state.copy(), choice[0].copy()
    for _ in range(PASSES):
        against, speakers = np.zeros(choice.shape), np.zeros(state.shape, dtype=int)
        for dy, dx in product(range(-REACH_PX, REACH_PX + 1), repeat=2):
            if dy or dx:
                there, (its_turn, its_k, its_state, its_lit, its_choice, its_cost) = _beside(
                    dy, dx, turn, k, state, lit, choice, cost
                )
                apart = turn - its_turn
                step = np.rint(apart)
                speaks = there & its_lit & (its_state != REFUSED)
                speaks &= np.abs(apart - step) <= STEP_PERIODS
                speakers += speaks
                for n in range(len(choice)):
                    wanted = choice[n] + step
                    clear = np.where(wanted == its_k, 0.0, MOST_AGAINST)
                    extra = np.where(its_choice == wanted, its_cost - its_cost[0], MOST_AGAINST)
                    says = np.where(
                        its_state == CLEAR, clear, np.minimum(extra, MOST_AGAINST).min(0)
                    )
                    against[n] += np.where(speaks, says, 0.0)
        own = cost - cost[0]
        total = np.where(own < MIN_LEAD, own + against, np.inf)
        ordered = np.sort(total, axis=0)
        best = total.argmin(axis=0)[None]
        agreed = (state == OPEN) & lit & (speakers >= MIN_NEIGHBOURS)
        agreed &= ordered[1] - ordered[0] >= MIN_LEAD
        agreed &= np.take_along_axis(against, best, 0)[0] <= MAX_AGAINST * MOST_AGAINST * speakers
        if not agreed.any():
            break
        k = np.where(agreed, np.take_along_axis(choice, best, 0)[0], k)
        state[agreed] = CLEAR
    return k, was_open & (state == CLEAR), state != CLEAR


def _vote(turn, k, refused, clear, votes):
    """Do the same as `settling.settle_refused`: return periods, and the settled pixels."""
    proposals = []
    for dy, dx in product(range(-REACH_PX, REACH_PX + 1), repeat=2):
        if dy or dx:
            there, (its_turn, its_k, its_clear) = _beside(dy, dx, turn, k, clear)
            apart = turn - its_turn
            step = np.rint(apart)
            speaks = there & its_clear & (np.abs(apart - step) <= STEP_PERIODS)
            proposals.append(np.where(speaks, its_k - step, np.nan))
    counts = np.array([np.sum(np.array(proposals) == one, axis=0) for one in proposals])
    most = counts.max(axis=0)
    best = np.take_along_axis(np.array(proposals), counts.argmax(axis=0)[None], 0)[0]
    others = np.isfinite(proposals).sum(axis=0) - most
    settled = refused & (most >= votes) & (others <= AGAINST_SHARE * most)
    return np.where(settled, best, k), settled


def _beside(dy, dx, *maps):
    """Return maps shifted to a neighbour, and where that neighbour is inside the picture."""
    h, w = maps[0].shape
    y, x = np.mgrid[0:h, 0:w]
    there = (y + dy >= 0) & (y + dy < h) & (x + dx >= 0) & (x + dx < w)
    return there, [np.roll(m, (-dy, -dx), axis=(-2, -1)) for m in maps]
