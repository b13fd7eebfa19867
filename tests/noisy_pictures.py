"""Decide by t-tests over independent seeds whether two sets of noisy pictures have one mean."""

import numpy as np

BLOCK_PX = 6


def blocks(image):
    """Return sums over square blocks of pixels, which are nearly normal and independent."""
    h, w = image.shape[-2:]
    split = image.reshape(*image.shape[:-2], h // BLOCK_PX, BLOCK_PX, w // BLOCK_PX, BLOCK_PX)
    return split.sum(axis=(-3, -1)).reshape(*image.shape[:-2], -1)


def scores(one, other):
    """Return Welch's t for each block and for the whole picture; the first axis is the seed."""

    def t(a, b):
        variance = a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b)
        return (a.mean(axis=0) - b.mean(axis=0)) / np.sqrt(variance)

    return t(one, other), t(one.sum(axis=-1), other.sum(axis=-1))


def agree(one, other):
    """Return whether two sets of pictures (seeds, blocks) can have the same mean.

    If they have, t has about n degrees of freedom: its mean square is n / (n - 2), and its fourth
    moment is 3 n^2 / ((n - 2) (n - 4)). Blocks without light are left out.
    """
    lit = (one.mean(axis=0) > 0) & (other.mean(axis=0) > 0)
    each, whole = scores(one[:, lit], other[:, lit])
    n = len(one) + len(other) - 2
    mean = n / (n - 2)
    spread = np.sqrt((3 * n * n / ((n - 2) * (n - 4)) - mean**2) / lit.sum())
    return bool(np.mean(each**2) < mean + 4 * spread and abs(whole) < 4)
