"""Hulls joined again wherever their common hull still follows the surface.

The time of a drop grows with the number of hulls, and cuts leave more of them than are needed.
"""

import heapq
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold

from .solid import surface_of

Points = Float[np.ndarray, "_ 3"]


def joined(
    hulls: list[Points],
    limit_m: float,
    *,
    guess_m: Callable[[Points], float],
    holds: Callable[[Points], bool],
) -> list[Points]:
    """Replaces pairs by their common hull, the least harmful first, while all hold.

    Args:
        hulls: vertices of each.
        limit_m: how far a hull may reach out of the part.
        guess_m: how far the hull of some points reaches out of it, about.
        holds: whether it reaches no farther than the limit, for certain.

    Returns:
        Vertices of each hull.
    """
    alive = dict(enumerate(hulls))
    waiting: list[tuple[float, int, int]] = []

    def consider(i: int, j: int) -> None:
        harm = guess_m(np.vstack([alive[i], alive[j]]))
        if harm <= limit_m:
            heapq.heappush(waiting, (harm, i, j))

    for j in range(1, len(hulls)):
        for i in _near(hulls[:j], hulls[j], limit_m):
            consider(int(i), j)
    new = len(hulls)
    while waiting:
        _, i, j = heapq.heappop(waiting)
        if i not in alive or j not in alive:
            continue
        both = np.vstack([alive[i], alive[j]])
        if not holds(both):
            continue
        del alive[i], alive[j]
        both = surface_of(Manifold.hull_points(both))[0]
        names = list(alive)
        near = _near(list(alive.values()), both, limit_m)
        alive[new] = both
        for other in near:
            consider(names[other], new)
        new += 1
    return list(alive.values())


def _near(others: list[Points], one: Points, gap_m: float) -> Int[np.ndarray, " n"]:
    """Which hulls have bounding boxes no farther than a gap from that of one."""
    if not others:
        return np.empty(0, dtype=np.int64)
    low = np.array([points.min(axis=0) for points in others])
    high = np.array([points.max(axis=0) for points in others])
    near = (low <= one.max(axis=0) + gap_m) & (one.min(axis=0) <= high + gap_m)
    return np.flatnonzero(near.all(axis=1))
