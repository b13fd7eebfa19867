"""Detect inverses that a program computed from the patterns, so that they lack noise."""

import numpy as np
from jaxtyping import Num

from ...rig.pattern import Code
from .frame_groups import inverse_pairs, opposite_steps

MOST_SAMPLES = 100_000
CONSTANT_DN = 2  # A computed sum differs from its constant by at most this, even after JPEG.
NEARLY_ALL = 0.99
# Sums of real pictures differ by the noise of four frames. Even with rounding alone, at most 60 %
# of the sums would be equal.
LIT_SHARE = 0.3  # Only pixels with this share of the highest contrast count; dark sums are all 0.
FEWEST = 200  # Smallest number of such pixels that is enough.


def computed_pairs(frames: Num[np.ndarray, "n h w"], code: Code) -> list[tuple[int, int]]:
    """Return the pairs of pattern and inverse, and of opposite steps, that were computed.

    A computed inverse is a constant, or a white picture, minus the pattern. With a constant, the
    sum of the pair is equal in all lit pixels, although a real scene varies in brightness. With a
    white picture, the sums of two such pairs are exactly equal.
    """
    pairs = [*inverse_pairs(code), *opposite_steps(code)]
    if not pairs:
        return []
    flat = frames.reshape(len(frames), -1)
    flat = flat[:, :: max(1, flat.shape[1] // MOST_SAMPLES)].astype(np.int32)
    contrast = flat.max(axis=0) - flat.min(axis=0)
    if not contrast.any():
        return []
    clear = contrast >= LIT_SHARE * contrast.max()
    clear &= flat.max(axis=0) < flat.max()  # Sums of saturated frames are equal, too.
    if clear.sum() < FEWEST:
        return []
    sums = [(flat[k] + flat[other])[clear] for k, other in pairs]
    return [
        pair
        for k, pair in enumerate(pairs)
        if _constant(sums[k])
        or any((sums[k] == other).mean() > NEARLY_ALL for other in _beside(sums, k))
    ]


def _beside(sums: list[np.ndarray], k: int) -> list[np.ndarray]:
    """Return the sums before and after sum `k`; a computed sum equals at least one of them."""
    return sums[max(k - 1, 0) : k] + sums[k + 1 : k + 2]


def _constant(values: np.ndarray) -> bool:
    return bool((np.abs(values - np.median(values)) <= CONSTANT_DN).mean() > NEARLY_ALL)


def describe_computed(pairs: int, of: int) -> str:
    """Return the warning for computed pairs."""
    return (
        f"{pairs} of {of} pairs of pattern and inverse add up to a constant, or to the same number "
        "in each pixel: the inverses were computed, not taken, so noise, black level and sigma "
        "cannot be measured in them: give the pictures that the camera took, or leave the inverses "
        "out"
    )
