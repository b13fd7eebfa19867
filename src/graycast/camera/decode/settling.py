"""Ambiguous periods of a pixel, which its neighbours on the same surface resolve."""

from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from ...base.kernels import kernel
from .median import median

CLEAR, OPEN, REFUSED = 0, 1, 2  # A pixel's own phases say this of its count of periods.
CHOICES = 4  # Only the best places of a pixel in doubt are kept.
REACH_PX = 2  # The neighbours are those of a window of 5 x 5 pixels.
# Neighbours on one surface may differ by this share of a period: beyond it the step between them
# may be either way, so they say nothing.
STEP_PERIODS = 0.3
MOST_AGAINST = 6.0  # A neighbour says at most this sum of squares, as MIN_LEAD is, against a place.
MIN_NEIGHBOURS = 8
# A place is taken if neighbours say at most this share of what they could say against it: a third
# of them, for instance, may see no such surface.
MAX_AGAINST = 0.34
PASSES = 8  # What one pass settles speaks in the next.
AGAINST_SHARE = 0.25  # More neighbours against a period, as a share of those for it, leave it open.


class Pixels(NamedTuple):
    """What neighbours say of one another.

    Attributes:
        first: phase of the first period [periods].
        choice, cost: of pixels in doubt the best periods, and their sums of squares.
        state: CLEAR, OPEN or REFUSED; settled ones are written as CLEAR.
        lit: pixels whose light is believed; others say nothing.
        number: of the period of clear pixels, which `settle` writes; -1 elsewhere.
    """

    first: Float32[np.ndarray, "h w"]
    choice: Int32[np.ndarray, "h 4 w"]
    cost: Float32[np.ndarray, "h 4 w"]
    state: UInt8[np.ndarray, "h w"]
    lit: Bool[np.ndarray, "h w"]
    number: Int32[np.ndarray, "h w"]


def settle(pixels, place, period, *, min_lead):
    """Resolve `OPEN` counts by the neighbours; without an agreement they stay open.

    A neighbour on the same surface sees the period that the step between both phases leads to, for
    each of a pixel's places another one. Against a place speaks its own cost and, of each
    neighbour, what that period costs there beyond its best; where one of them leads the others by
    `min_lead` and enough of the neighbours agree, it is taken. A clear pixel is never changed.

    Args:
        place: place of clear pixels [px]; those of settled ones are written.
        period: the first one's length [px], a float32.

    Returns:
        which were settled.
    """
    _counts(pixels, period, place)
    before = pixels.state == OPEN
    for _ in range(PASSES):
        pick = np.full(place.shape, -1, dtype=np.int32)
        _agree(pixels, np.float32(min_lead), pick)
        if not _take(pixels, period, pick, place).any():
            break
    return before & (pixels.state == CLEAR)


@kernel(parallel=True)
def _counts(pixels, period, place):
    first, state, lit, count = pixels.first, pixels.state, pixels.lit, pixels.number
    for y in numba.prange(len(place)):
        for x in range(place.shape[1]):
            if state[y, x] == CLEAR and lit[y, x]:
                count[y, x] = np.int32(np.rint(place[y, x] / period - first[y, x]))


@kernel(parallel=True)
def _take(pixels, period, pick, place):
    """Write the agreed periods; return which rows have any."""
    first, state, count = pixels.first, pixels.state, pixels.number
    any_taken = np.zeros(len(pick), dtype=np.bool_)
    for y in numba.prange(len(pick)):
        for x in range(pick.shape[1]):
            if pick[y, x] >= 0:
                any_taken[y] = True
                state[y, x] = CLEAR
                count[y, x] = pick[y, x]
                place[y, x] = (np.float32(pick[y, x]) + first[y, x]) * period
    return any_taken


@kernel(parallel=True)
def _agree(pixels, min_lead, pick):
    state, lit = pixels.state, pixels.lit
    for y in numba.prange(len(pick)):
        against = np.empty(CHOICES, dtype=np.float32)
        for x in range(pick.shape[1]):
            if state[y, x] == OPEN and lit[y, x]:
                pick[y, x] = _agreed(pixels, np.int64(y), x, against, min_lead)


@kernel()
def _agreed(pixels, y, x, against, min_lead):
    """The period that this pixel and its neighbours agree on; -1 where they do not."""
    first, choice, cost, state, lit, count = pixels
    h, w = first.shape
    against[:] = 0
    voters = 0
    for j in range(max(y - REACH_PX, 0), min(y + REACH_PX + 1, h)):
        for i in range(max(x - REACH_PX, 0), min(x + REACH_PX + 1, w)):
            if (j == y and i == x) or not lit[j, i] or state[j, i] == REFUSED:
                continue
            apart = first[y, x] - first[j, i]
            step = np.rint(apart)
            if abs(apart - step) > np.float32(STEP_PERIODS):
                continue
            voters += 1
            for n in range(CHOICES):
                period = choice[y, n, x] + np.int32(step)
                if state[j, i] == CLEAR:
                    most = np.float32(0 if period == count[j, i] else MOST_AGAINST)
                else:
                    most = np.float32(MOST_AGAINST)
                    for m in range(CHOICES):
                        if choice[j, m, i] == period:
                            most = min(most, cost[j, m, i] - cost[j, 0, i])
                against[n] += most
    if voters < MIN_NEIGHBOURS:
        return -1
    best, lead = -1, np.float32(np.inf)
    for n in range(CHOICES):
        if cost[y, n, x] - cost[y, 0, x] >= min_lead:
            continue
        total = against[n] + cost[y, n, x] - cost[y, 0, x]
        if best < 0:
            best, least = n, total
        elif total < least:
            best, lead, least = n, least - total, total
        else:
            lead = min(lead, total - least)
    if lead < min_lead or against[best] > np.float32(MAX_AGAINST * MOST_AGAINST) * voters:
        return -1
    return choice[y, best, x]


def settle_refused(period_px, turn, place, refused, clear, *, votes):
    """Count the periods of pixels whose own code contradicts itself, by their neighbours.

    The phase of such a pixel is known; what is not is its period. Each clear neighbour on the same
    surface says one. The period is taken that at least `votes` neighbours say, if hardly any says
    another one. What is settled does not speak for others, so large regions are not filled.

    Args:
        turn: phase [periods], (h, w).
        place: place of clear pixels [px]; those of settled ones are written.
        refused, clear: which pixels are to be settled and which speak, (h, w).

    Returns:
        which were settled.
    """
    settled = np.zeros(place.shape, dtype=np.bool_)
    _vote(np.float32(period_px), turn, place, refused, clear, votes, settled)
    return settled


@kernel(parallel=True)
def _vote(period, turn, place, refused, clear, votes, settled):
    h, w = place.shape
    side = 2 * REACH_PX + 1
    for y in numba.prange(h):
        offset = np.empty(side * side)
        for x in range(w):
            if not refused[y, x]:
                continue
            count = 0
            for j in range(max(y - REACH_PX, 0), min(y + REACH_PX + 1, h)):
                for i in range(max(x - REACH_PX, 0), min(x + REACH_PX + 1, w)):
                    apart = turn[y, x] - turn[j, i]
                    step = np.rint(apart)
                    if clear[j, i] and abs(apart - step) <= np.float32(STEP_PERIODS):
                        its_own = np.rint(place[j, i] / period - turn[j, i])
                        offset[count] = its_own - step
                        count += 1
            if count < votes:
                continue
            k = np.int32(median(offset[:count], 1))  # most say it, or there is no agreement
            agreed = (offset[:count] == k).sum()
            if agreed >= votes and count - agreed <= AGAINST_SHARE * agreed:
                settled[y, x] = True
                place[y, x] = (np.float32(k) + turn[y, x]) * period
