"""Gray bits, row by row: what they read, and what doubt in them costs."""

import math
from typing import no_type_check

import numba
import numpy as np

XOR_SIGMAS = 3.0  # a stripe's edge flips all bits that share it: noise alone decides there


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def read_gray(stack, bits, grid, law, high, low, coarse, variance, rival, why):
    """Bits to the middle of the code value's cell, and what doubt in them makes of it.

    `variance` is what doubt adds [px^2], `rival` how far off the value lies that a doubtful bit, if
    there is one, would make of it [px].
    """
    count, w = len(bits), high.shape[1]
    for y in numba.prange(len(high)):
        margin = np.empty((count, w), dtype=np.int32)
        value = np.zeros(w, dtype=np.int32)
        _read_bits(stack, y, bits, high[y], low[y], margin, value)
        _weigh_doubts(
            bits, grid, law, high[y], low[y], margin, value, variance[y], rival[y], why[y]
        )
        for x in range(w):
            coarse[y, x] = grid[0] + grid[1] * (np.float32(value[x]) + np.float32(0.5))


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _read_bits(stack, y, bits, high, low, margin, value):
    """Each bit's signal, pattern minus inverse or twice its distance to the middle, and the value.

    `value` starts at 0.
    """
    count, w = margin.shape
    for b in range(count):
        first = stack[bits[b, 0], y]
        of_bit = margin[b]
        if bits[b, 1] >= 0:
            second = stack[bits[b, 1], y]
            for x in range(w):
                of_bit[x] = np.int32(first[x]) - np.int32(second[x])
        else:
            for x in range(w):
                of_bit[x] = np.int32(2) * np.int32(first[x]) - np.int32(high[x] + low[x])
        for x in range(w):
            value[x] = (value[x] << np.int32(1)) | np.int32(of_bit[x] > 0)
    for b in range(count):
        if bits[b, 2] >= 0:
            here, base = np.int32(count - 1 - b), np.int32(count - 1 - bits[b, 2])
            for x in range(w):
                value[x] ^= ((value[x] >> base) & np.int32(1)) << here
    for x in range(w):  # Gray to binary: prefix exclusive-or of up to 32 bits
        word = value[x] ^ (value[x] >> np.int32(16))
        word ^= word >> np.int32(8)
        word ^= word >> np.int32(4)
        word ^= word >> np.int32(2)
        value[x] = word ^ (word >> np.int32(1))


@numba.njit(cache=True, error_model="numpy")
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _weigh_doubts(bits, grid, law, high, low, margin, value, variance, rival, why):
    """What doubtful bits cost: variance [px^2], or a contradiction.

    A bit whose signal is `t` standard deviations from its threshold is wrong with probability
    Q(t), taken as (1 - t / 3)^3 / 2, which is within 0.02; the value is then another, known one.
    """
    offset_dn, floor_dn2, slope_dn, doubt = law
    cell_px, reach = grid[1], grid[2]
    count, w = margin.shape
    zero, one, two = np.float32(0), np.float32(1), np.float32(2)
    noise = np.empty(w, dtype=np.float32)  # of pattern minus inverse [DN]
    third = np.empty(w, dtype=np.float32)
    contrast = np.empty(w, dtype=np.float32)
    for x in range(w):
        light = max(high[x] + low[x] - two * offset_dn, zero)
        noise[x] = math.sqrt(two * floor_dn2 + slope_dn * light)
        third[x] = np.float32(1 / 3) / noise[x]
        contrast[x] = high[x] - low[x]
    counted = bits[:, 3].sum()
    doubts = np.zeros((2, w), dtype=np.int32)
    seen = 0
    for b in range(count):
        of_bit = margin[b]
        # Without an inverse the threshold is noisy too: (2 I) - (high + low) has 3 times the noise.
        paired = bits[b, 1] >= 0
        scale = one if paired else np.float32(1 / math.sqrt(3.0))
        flip = np.int32((2 << (count - 1 - b)) - 1)
        for x in range(w):
            size = abs(np.float32(of_bit[x]))
            wrong = max(one - size * (third[x] * scale), zero)
            apart_px = cell_px * (np.float32(np.int32(value[x] ^ flip)) - np.float32(value[x]))
            variance[x] += np.float32(0.5) * (wrong * wrong * wrong) * (apart_px * apart_px)
        if bits[b, 3] == 0:
            continue
        of_half = doubts[0 if 2 * seen < counted else 1]
        seen += 1
        limit, share = contrast, doubt
        if bits[b, 2] >= 0:
            limit, share = noise, np.float32(XOR_SIGMAS) / scale
        for x in range(w):
            size = abs(np.float32(of_bit[x]))
            apart = np.float32(np.int32(value[x] ^ flip)) - np.float32(value[x])
            grave = np.int32(1) + np.int32(abs(apart) > reach)
            of_half[x] += grave if size < share * limit[x] else np.int32(0)
            rival[x] = cell_px * apart if size < share * limit[x] else rival[x]
    coarse, fine = doubts[0], doubts[1]
    for x in range(w):
        # Light from elsewhere spoils the coarse bits alone.
        said = np.uint8(5) if fine[x] == 0 else np.uint8(4)
        why[x] = said if (why[x] == 0) & (coarse[x] + fine[x] >= 2) else why[x]
