"""Phases, decoded row by row: phases from levels, and the counting of their periods."""

import math
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float, Float32

from ...base.kernels import kernel
from .plan import MODEL_RAD, OFF_CELL
from .reasons import Reason
from .settling import CLEAR, OPEN, REFUSED

MAX_MISFIT = 9.0  # A position is refused if the mean square of its residuals, in sigmas, is larger.
# The cost of the second-best position must be higher by this (4 sigma), else the choice is open.
MIN_LEAD = 16.0
APART_SIGMAS = (
    4.0  # A phase that differs from the finest one by more than this is not averaged with it.
)
USUAL_SIGMAS = 2.0  # Up to this many sigmas, a difference between phases does not widen sigma.
SLACK_SIGMAS = 4.0  # A position may exceed its bounds by this many sigmas of its phase's noise.
NOWHERE = 1e30  # Cost of a position that is out of bounds.


class Phases(NamedTuple):
    """The measured phases of an axis, for a picture or one row.

    Attributes:
        periods: for each period its length [px], the index of its first frame, the number of its
            frames, and the variance of its phase in addition to noise [rad^2].
        delta: the phase at which each frame is brightest [rad].
        half_px: largest distance of a position from the middle of its cell, without noise.
        bounds: lowest position [periods] and upper limit [px]; `bound` writes them.
        turn: phases [periods]; for a single frame, the cosine of the phase.
        noise2: variances of `turn` [rad^2].
    """

    periods: Float[np.ndarray, "periods 4"]
    delta: Float[np.ndarray, " frames"]
    half_px: float
    bounds: Float32[np.ndarray, "*h 2 w"]
    turn: Float32[np.ndarray, "*h periods w"]
    noise2: Float32[np.ndarray, "*h periods w"]


@kernel(parallel=True, error_model="numpy")
def read_phases(stack, periods, index, waves, law, strength, turn, noise2):
    """Write the phase of each full period [periods], the cosine of single frames, and variances."""
    w = strength.shape[1]
    for y in numba.prange(len(strength)):
        first = np.empty((3, w), dtype=np.float32)  # Mean, amplitude, variance of the first period
        for g in range(len(periods)):
            start, count = int(periods[g, 1]), int(periods[g, 2])
            if count < 3:
                frame = stack[index[start], y]
                _lone_frame(frame, first, periods[g, 3], turn[y, g], noise2[y, g])
                continue
            sums = np.zeros((5, w), dtype=np.float32)
            for j in range(start, start + count):
                _add_frame(stack[index[j], y], waves[j], sums)
            _phase(sums, np.float32(count), law, turn[y, g], noise2[y, g])
            if g == 0:
                _amplitude(sums, np.float32(count), law, first, strength[y])


@kernel()
def _add_frame(frame, wave, sums):
    total, c, s, c2, s2 = sums[0], sums[1], sums[2], sums[3], sums[4]
    for x in range(len(frame)):
        level = np.float32(frame[x])
        total[x] += level
        c[x] += level * wave[0]
        s[x] += level * wave[1]
    for x in range(len(frame)):
        level = np.float32(frame[x])
        c2[x] += level * wave[2]
        s2[x] += level * wave[3]


@kernel(error_model="numpy")
def _phase(sums, count, law, turn, noise2):
    """Write phase [periods] and variance [rad^2], from sums of level * (1, cos, sin, cos 2, sin 2).

    The least-squares phase of N even steps with amplitude A has the variance 4 / (N A)^2 times the
    sum of var_j sin^2(phase - delta_j), and var_j is linear in the level of frame j.
    """
    offset_dn, floor_dn2, slope_dn = law
    total, c, s, c2, s2 = sums[0], sums[1], sums[2], sums[3], sums[4]
    two = np.float32(2)
    for x in range(len(turn)):
        square = c[x] * c[x] + s[x] * s[x]
        light = max(total[x] - count * offset_dn, np.float32(0))
        twice = (c[x] * c[x] - s[x] * s[x]) * c2[x] + two * c[x] * s[x] * s2[x]
        spread = slope_dn * (light - twice / square)
        noise2[x] = (count * floor_dn2 + max(spread, np.float32(0))) / (two * square)
    for x in range(len(turn)):
        turn[x] = _turn(s[x], c[x])


@kernel(error_model="numpy")
def _amplitude(sums, count, law, first, strength):
    """Write mean, amplitude [DN] and variance [DN^2] of a frame; limit strength to the contrast."""
    offset_dn, floor_dn2, slope_dn = law
    total, c, s = sums[0], sums[1], sums[2]
    mean, amplitude, variance = first[0], first[1], first[2]
    two = np.float32(2)
    for x in range(len(strength)):
        mean[x] = total[x] / count
        amplitude[x] = two / count * math.sqrt(c[x] * c[x] + s[x] * s[x])
        variance[x] = floor_dn2 + slope_dn * max(mean[x] - offset_dn, np.float32(0))
        strength[x] = min(strength[x], two * amplitude[x])


@kernel(error_model="numpy")
def _lone_frame(frame, first, model2, cosine, noise2):
    mean, amplitude, variance = first[0], first[1], first[2]
    model2, two = np.float32(model2), np.float32(2)
    for x in range(len(frame)):
        cosine[x] = (np.float32(frame[x]) - mean[x]) / amplitude[x]
        # Twice a frame's variance: mean, amplitude and phase of the three steps are noisy, too.
        noise2[x] = two * variance[x] / (amplitude[x] * amplitude[x]) + model2


@kernel(parallel=True)
def lose_phases(stack, index, top, saturation_dn, why):
    """Mark pixels where a phase is lost because one of its own frames is saturated."""
    for y in numba.prange(len(why)):
        if not top[y].any():
            continue
        for k in index:
            frame = stack[k, y]
            for x in range(len(frame)):
                lost = np.float32(frame[x]) >= saturation_dn
                free = why[y, x] == Reason.DECODED
                why[y, x] = np.uint8(Reason.SATURATED) if lost & free else why[y, x]


@kernel(parallel=True, error_model="numpy")
def count_by_gray(periods, cell_px, turn, place, variance, rival, why):
    """Count periods so that the first phase is nearest to the Gray code's cell; update `place`.

    An uncertain bit has no effect if both of its values lead to the same period.
    """
    period, half, two = np.float32(periods[0, 0]), np.float32(0.5), np.float32(2)
    slack = half * cell_px + np.float32(OFF_CELL) * period
    for y in numba.prange(len(place)):
        for x in range(place.shape[1]):
            k = np.floor(place[y, x] / period - turn[y, 0, x] + half)
            u = (k + turn[y, 0, x]) * period
            other = np.floor((place[y, x] + rival[y, x]) / period - turn[y, 0, x] + half)
            far = abs(u - place[y, x]) > slack + two * math.sqrt(variance[y, x])
            wrong = (far | (other != k)) & (why[y, x] == Reason.DECODED)
            why[y, x] = np.uint8(Reason.INTERREFLECTION) if wrong else why[y, x]
            place[y, x] = u


@kernel(parallel=True, error_model="numpy")
def bound(phases, middle):
    """Write the bounds of each pixel's positions: the lowest [periods] and an upper limit [px].

    A position is within `half_px` of the middle, plus a margin for the noise of its phase.
    """
    periods, bounds, turn, noise2 = phases.periods, phases.bounds, phases.turn, phases.noise2
    half_px = np.float32(phases.half_px)
    period, most = np.float32(periods[0, 0]), np.float32(math.pi)  # The largest error of a phase
    per_rad, sigmas = period / np.float32(2 * math.pi), np.float32(SLACK_SIGMAS)
    for y in numba.prange(len(middle)):
        for x in range(middle.shape[1]):
            off = sigmas * math.sqrt(noise2[y, 0, x])
            reach = half_px + per_rad * (off if off < most else most)
            first = np.ceil((middle[y, x] - reach) / period - turn[y, 0, x])
            bounds[y, 0, x] = max(first, np.float32(0)) + turn[y, 0, x]
            bounds[y, 1, x] = middle[y, x] + reach


@kernel(parallel=True, error_model="numpy")
def count_by_phases(phases, place, state):
    """Find the period of the first group that fits all other groups, by a search in the bounds.

    The count is refused if no period fits, and open if two fit.
    """
    periods, delta, half_px, bounds, turn, noise2 = phases
    for y in numba.prange(len(place)):
        row = Phases(periods, delta, half_px, bounds[y], turn[y], noise2[y])
        _search_row(row, place[y], state[y])


@kernel(error_model="numpy")
def _most_places(row):
    """Return the largest number of periods between a pixel's bounds."""
    return math.floor(2 * row.half_px / row.periods[0, 0] + 1) + 1


@kernel(error_model="numpy")
def _search_row(row, place, state):
    groups, w = row.turn.shape
    period, first = np.float32(row.periods[0, 0]), row.bounds[0]
    costs = np.empty(w, dtype=np.float32)
    best = np.full(w, np.float32(NOWHERE))
    second = np.full(w, np.float32(NOWHERE))
    expected = np.empty((groups, 3, w), dtype=np.float32)
    for g in range(1, groups):
        _expect(row, g, expected[g])
    for k in range(_most_places(row)):
        _cost(k, row, expected, costs)
        at = np.float32(k)
        for x in range(w):
            better = costs[x] < best[x]
            second[x] = best[x] if better else min(second[x], costs[x])
            place[x] = (at + first[x]) * period if better else place[x]
            best[x] = min(best[x], costs[x])
    limit = np.float32(MAX_MISFIT * (groups - 1))
    for x in range(w):
        count = np.uint8(CLEAR if second[x] - best[x] >= np.float32(MIN_LEAD) else OPEN)
        state[x] = count if best[x] <= limit else np.uint8(REFUSED)


@kernel(parallel=True, error_model="numpy")
def open_choices(phases, state, choice, cost):
    """Write the best periods for pixels with open counts, and their costs, the best first."""
    periods, delta, half_px, bounds, turn, noise2 = phases
    for y in numba.prange(len(state)):
        where = np.nonzero(state[y] == OPEN)[0]
        if len(where) == 0:
            continue
        count = choice.shape[1]
        best = np.full((count, len(where)), -1, dtype=np.int32)
        costs = np.full((count, len(where)), np.float32(NOWHERE))
        of_open = bounds[y][:, where], turn[y][:, where], noise2[y][:, where]
        row = Phases(periods, delta, half_px, of_open[0], of_open[1], of_open[2])
        _search_all(row, best, costs)
        for n in range(count):
            for i in range(len(where)):
                choice[y, n, where[i]] = best[n, i]
                cost[y, n, where[i]] = costs[n, i]


@kernel(error_model="numpy")
def _search_all(row, choice, cost):
    """Write each pixel's periods of lowest cost to the rows of `choice`, the best first."""
    groups, w = row.turn.shape
    costs = np.empty(w, dtype=np.float32)
    number = np.empty(w, dtype=np.int32)
    expected = np.empty((groups, 3, w), dtype=np.float32)
    for g in range(1, groups):
        _expect(row, g, expected[g])
    for k in range(_most_places(row)):
        _cost(k, row, expected, costs)
        for x in range(w):
            number[x] = k + np.int32(np.rint(row.bounds[0, x] - row.turn[0, x]))
        for n in range(len(choice)):  # A displaced entry is compared with the next row.
            best, price = choice[n], cost[n]
            for x in range(w):
                better = costs[x] < price[x]
                other, dear = best[x], price[x]
                best[x] = number[x] if better else other
                price[x] = costs[x] if better else dear
                number[x] = other if better else number[x]
                costs[x] = dear if better else costs[x]


@kernel(error_model="numpy")
def _cost(k, row, expected, costs):
    """Write the cost of the position `k` periods above the lowest; `NOWHERE` if out of bounds."""
    periods, lowest, highest = row.periods, row.bounds[0], row.bounds[1]
    period, at = np.float32(periods[0, 0]), np.float32(k)
    for x in range(len(costs)):
        out = (at + lowest[x]) * period > highest[x]
        costs[x] = np.float32(NOWHERE) if out else np.float32(0)
    for g in range(1, len(periods)):
        turns = k * periods[0, 0] / periods[g, 0]
        if periods[g, 2] < 3:
            c, s = math.cos(2 * math.pi * turns), math.sin(2 * math.pi * turns)
            _add_cosine_cost(row.turn[g], np.float32(c), np.float32(s), expected[g], costs)
        else:
            _add_phase_cost(np.float32(turns - math.floor(turns)), expected[g], costs)


@kernel(error_model="numpy")
def _expect(row, g, expected):
    """Write a group's expected values at the lowest position, and their weight: that position's
    phase minus the group's phase or, for a single frame, the position's cosine and sine."""
    periods, first, noise2 = row.periods, row.bounds[0], row.noise2
    ratio = periods[0, 0] / periods[g, 0]
    here, aside, weight = expected[0], expected[1], expected[2]
    if periods[g, 2] < 3:
        lag = row.delta[int(periods[g, 1])]
        for x in range(len(first)):
            angle = np.float32(2 * math.pi * ratio * first[x] - lag)
            here[x] = math.cos(angle)
            aside[x] = math.sin(angle)
            weight[x] = np.float32(1) / noise2[g, x]
    else:
        its_turn = row.turn[g]
        tau2, model2 = np.float32(4 * math.pi**2), np.float32(periods[g, 3])
        for x in range(len(first)):
            here[x] = np.float32(ratio) * first[x] - its_turn[x]
            weight[x] = tau2 / (noise2[g, x] + noise2[0, x] + model2)


@kernel()
def _add_phase_cost(turns, expected, costs):
    here, weight = expected[0], expected[2]
    for x in range(len(costs)):
        apart = turns + here[x]
        apart -= np.floor(apart + np.float32(0.5))
        costs[x] += weight[x] * (apart * apart)


@kernel()
def _add_cosine_cost(cosine, c, s, expected, costs):
    here, aside, weight = expected[0], expected[1], expected[2]
    for x in range(len(costs)):
        apart = cosine[x] - (c * here[x] - s * aside[x])
        costs[x] += weight[x] * (apart * apart)


@kernel(parallel=True, error_model="numpy")
def fuse(periods, turn, noise2, place, sigma):
    """Average the positions of all full periods, weighted by inverse variance.

    For each phase, the position nearest to the first one counts. A non-linear projector
    and indirect light move a position by a share of the period. If two periods differ by more than
    their noise, `sigma` becomes wider, under the assumption that errors are proportional to the
    periods' lengths. A period that differs too much is left out.
    """
    w = place.shape[1]
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    limit, model2 = np.float32(APART_SIGMAS**2), np.float32(MODEL_RAD**2)
    usual2 = np.float32(USUAL_SIGMAS**2)
    for y in numba.prange(len(place)):
        u, error = place[y], sigma[y]
        weight = np.zeros(w, dtype=np.float32)
        summed = np.zeros(w, dtype=np.float32)
        beyond = np.zeros(w, dtype=np.float32)  # Squared difference beyond noise [px^2]
        for g in range(len(periods)):
            if periods[g, 2] < 3:
                continue
            length = np.float32(periods[g, 0])
            per_px2 = np.float32((2 * math.pi / periods[g, 0]) ** 2)
            its_turn, its_noise2, first_noise2 = turn[y, g], noise2[y, g], noise2[y, 0]
            error_share = np.float32(1 / (1 + (periods[g, 0] / periods[0, 0]) ** 2))
            shorter2 = np.float32((periods[0, 0] / periods[g, 0]) ** 2)
            for x in range(w):
                apart = u[x] / length - its_turn[x]
                apart = (np.floor(apart + half) - apart) * length
                noise = its_noise2[x] + first_noise2[x] + model2
                agrees = apart * apart * per_px2 <= limit * noise
                share = per_px2 / its_noise2[x] if agrees else zero
                weight[x] += share
                summed[x] += share * apart
                usual = usual2 * (its_noise2[x] + shorter2 * first_noise2[x]) / per_px2
                beyond[x] = max(beyond[x], error_share * (apart * apart - usual))
        for x in range(w):
            u[x] += summed[x] / weight[x]
            error[x] = math.sqrt(one / weight[x] + beyond[x])


@kernel(error_model="numpy")
def _turn(s, c):
    """Return atan2 in turns, -1/2 to 1/2, by a polynomial that compiles to SIMD.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions, 4.4.49 (within 2e-8 rad).
    """
    across, along = abs(s), abs(c)
    longer = max(across, along)
    r = min(across, along) / max(longer, np.float32(1e-30))
    z = r * r
    p = np.float32(0.0028662257)
    p = p * z + np.float32(-0.0161657367)
    p = p * z + np.float32(0.0429096138)
    p = p * z + np.float32(-0.0752896400)
    p = p * z + np.float32(0.1065626393)
    p = p * z + np.float32(-0.1420889944)
    p = p * z + np.float32(0.1999355085)
    p = p * z + np.float32(-0.3333314528)
    angle = (p * z + np.float32(1)) * r * np.float32(0.5 / math.pi)
    angle = np.float32(0.25) - angle if across > along else angle
    angle = np.float32(0.5) - angle if c < 0 else angle
    return -angle if s < 0 else angle
