"""Connected surfaces of pixels, by union-find (Tarjan, 1975).

A parent has a lower index than its members, and a root is its own parent.
"""

import numpy as np
from jaxtyping import Int

from ...base.kernels import kernel


@kernel()
def root(parent, i):
    """Return the root of a pixel, and shorten the way to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel()
def unite(parent, i, j):
    """Join the surfaces of two pixels."""
    a, b = root(parent, i), root(parent, j)
    parent[max(a, b)] = min(a, b)


@kernel()
def flatten(parent):
    """Make the root of each pixel its parent."""
    for i in range(len(parent)):
        parent[i] = parent[parent[i]]  # A parent has a lower index, so its parent is a root now.


def sizes(parent: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the number of pixels of each pixel's surface, from flattened parents."""
    return np.bincount(parent, minlength=len(parent))[parent]
