"""Resolution of a pixel's ambiguous period by its neighbours on the same surface."""

from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from ...base.kernels import kernel
from .median import median

# A pixel's own phases fit one period number (CLEAR), several (OPEN) or none (REFUSED).
CLEAR, OPEN, REFUSED = 0, 1, 2
CHOICES = 4  # The number of candidate positions of a pixel with an open count.
REACH_PX = 2  # The neighbours are in a window of 5 x 5 pixels.
# Phases of neighbours on one surface may differ by this share of a period. If they differ more, the
# sign of the step is ambiguous and the neighbour has no vote.
STEP_PERIODS = 0.3
MOST_AGAINST = 6.0  # The largest cost that a neighbour adds to a position, in units of MIN_LEAD.
MIN_NEIGHBOURS = 8
# A position is accepted if neighbours add at most this share of the largest possible cost. So about
# a third of them may see another surface.
MAX_AGAINST = 0.34
PASSES = 8  # Pixels that one pass settles have a vote in the next pass.
AGAINST_SHARE = 0.25  # A period with more votes against it, as a share of those for it, stays open.


class Pixels(NamedTuple):
    """Maps of the pixels that vote for one another.

    Attributes:
        first: phase of the first period [periods].
        choice, cost: the best periods of open pixels, and their sums of squares.
        state: CLEAR, OPEN or REFUSED; `settle` writes CLEAR for settled pixels.
        lit: pixels with reliable light; others have no vote.
        number: number of the period of clear pixels, which `settle` writes; -1 elsewhere.
    """

    first: Float32[np.ndarray, "h w"]
    choice: Int32[np.ndarray, "h 4 w"]
    cost: Float32[np.ndarray, "h 4 w"]
    state: UInt8[np.ndarray, "h w"]
    lit: Bool[np.ndarray, "h w"]
    number: Int32[np.ndarray, "h w"]


def settle(pixels, place, period, *, min_lead):
    """Resolve `OPEN` counts of periods by the neighbours; without agreement, counts remain open.

    The step between two phases gives, for each candidate position of a pixel, the period that a
    neighbour on the same surface would have. The total cost of a candidate is its own cost plus,
    for each neighbour, the cost of that period there minus its lowest cost. The best candidate is
    accepted if it leads by `min_lead` and enough neighbours agree. Clear pixels never change.

    Args:
        place: positions of clear pixels [px]; positions of settled pixels are written to it.
        period: length of the first period [px], a float32.

    Returns:
        A mask of the settled pixels.
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
    """Write the agreed periods; return a mask of the rows that changed."""
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
    """Return the period on which this pixel and its neighbours agree, or -1."""
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
    """Settle the periods of pixels with a contradictory code by votes of their neighbours.

    The phase of such a pixel is known, but not its period. Each clear neighbour on the same surface
    votes for a period. A period with at least `votes` votes is accepted if hardly any neighbour
    votes for another one. Settled pixels have no votes, so large regions are not filled.

    Args:
        turn: phase [periods], (h, w).
        place: positions of clear pixels [px]; positions of settled pixels are written to it.
        refused, clear: masks of the pixels to be settled and of those that vote, (h, w).

    Returns:
        A mask of the settled pixels.
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
            k = np.int32(median(offset[:count], 1))  # The only period that can have a majority
            agreed = (offset[:count] == k).sum()
            if agreed >= votes and count - agreed <= AGAINST_SHARE * agreed:
                settled[y, x] = True
                place[y, x] = (np.float32(k) + turn[y, x]) * period
