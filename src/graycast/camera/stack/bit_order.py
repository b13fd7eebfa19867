"""Detect Gray bits in wrong order, or swapped with inverses, by jumps between neighbours."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from jaxtyping import Float

from ...rig.pattern import Axis, Code
from ..decode.plan import AxisPlan

MENDED_OF = 30_000  # Changes of the order are tried on this many pairs.
# Neighbours are far apart if they differ by this distance, and by this many Gray values.
FAR_PX, FAR_VALUES = 8.0, 1.5
# A larger share of far neighbours than TORN is a fault; a remedy leaves less than FEWER of them.
TORN, FEWER = 2e-3, 0.5
LEAST = 50  # Fewer pairs are no evidence.


def bits_fault(
    pairs_px: Float[np.ndarray, "n 2"], code: Code, axis: Axis, plan: AxisPlan
) -> str | None:
    """Return a warning with the change of the bits that removes most jumps, or None.

    Args:
        pairs_px: positions of neighbouring pixels, decoded from the bits alone.
    """
    if len(pairs_px) < LEAST:
        return None
    far = far_share(pairs_px, plan)
    remedy = _mended(pairs_px, code, plan, far)
    if remedy is None:
        return None
    change, left = remedy
    return (
        f"{100 * far:.1f} % of neighbouring well lit pixels are over {far_px(plan):g} {axis}s "
        f"apart, {100 * left:.1f} % if {change}"
    )


def far_px(plan: AxisPlan) -> float:
    """Return the distance above which neighbours are far apart; adjacent Gray values are nearer."""
    return max(FAR_PX, FAR_VALUES * plan.cell_px) if plan.bits else FAR_PX


def far_share(pairs_px: Float[np.ndarray, "n 2"], plan: AxisPlan) -> float:
    """Return the share of neighbours that are far apart."""
    return float((np.abs(pairs_px[:, 1] - pairs_px[:, 0]) > far_px(plan)).mean())


def _mended(pairs_px, code: Code, plan: AxisPlan, far: float) -> tuple[str, float] | None:
    """Return a text for the change of the bits that removes most jumps, and the remaining share."""
    if plan.periods:  # Use only the few pairs that are at an edge of a Gray value.
        pairs_px = pairs_px[pairs_px[:, 0] != pairs_px[:, 1]]
    if len(pairs_px) < LEAST or far_share(pairs_px, plan) < TORN:
        return None
    all_far = far_share(pairs_px, plan)
    pairs_px = pairs_px[:: max(1, len(pairs_px) // MENDED_OF)]
    value = np.floor((pairs_px - plan.first_px) / plan.cell_px).astype(np.int64)
    gray = value ^ (value >> 1)
    best = None
    for change, order, turned in _changes(code, plan):
        mended_px = _binary(_reordered(gray, order) ^ turned) * plan.cell_px
        left = far_share(mended_px, plan)
        if left < FEWER * all_far and (best is None or left < best[1]):
            best = change, left
    return None if best is None else (best[0], best[1] * far / all_far)


def _changes(code: Code, plan: AxisPlan) -> Iterator[tuple[str, list[int], int]]:
    """Yield each candidate error: its description, the bit order, and a mask of inverted bits."""
    count = len(plan.bits)
    names = [code.frames[bit.frame].name for bit in plan.bits]
    as_is = [*range(count)]
    for k in as_is:
        yield f"{names[k]} were its inverse: the two may be swapped", as_is, 1 << (count - 1 - k)
    numbered = [k for k in as_is if code.frames[plan.bits[k].frame].kind == "gray"]
    last = as_is[len(numbered) :]  # A complementary bit has no number that could be wrong.
    if len(numbered) > 1:
        opposite = "all bits were in the opposite order: check that bit 0 is the finest"
        yield opposite, numbered[::-1] + last, 0
    for k, other in combinations(as_is, 2):
        order = as_is.copy()
        order[k], order[other] = other, k
        yield f"{names[k]} and {names[other]} were exchanged: their order may be wrong", order, 0
    for by in range(1, len(numbered)):
        moved = f"{by} finer" if 2 * by <= len(numbered) else f"{len(numbered) - by} coarser"
        deviation = f"each bit were {moved}, in a cycle: a file may be missing"
        yield deviation, numbered[by:] + numbered[:by] + last, 0


def _reordered(gray, order: list[int]):
    """Return Gray values whose k-th bit from the top is bit `order[k]` of the given values."""
    last = len(order) - 1
    bits = [((gray >> (last - source)) & 1) << (last - k) for k, source in enumerate(order)]
    return np.bitwise_or.reduce(bits)


def _binary(gray):
    """Decode a Gray code of up to 32 bits."""
    for shift in (16, 8, 4, 2, 1):
        gray = gray ^ (gray >> shift)
    return gray
