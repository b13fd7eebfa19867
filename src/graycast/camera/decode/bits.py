"""Gray bits, decoded row by row: their values, and the variance from uncertain bits."""

import math
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float32, Int

from ...base.kernels import kernel
from .reasons import Reason

# An edge of the base bit flips all bits that are combined with it, so several weak bits are no
# contradiction there, and only noise makes them doubtful. But scattered light leaves little signal,
# and then other errors flip bits anywhere. So a costly bit must also have `XOR_DOUBT` of the signal
# that other bits need: below 1 because the base bit has edges, too.
XOR_SIGMAS = 3.0
XOR_DOUBT = 2 / 3
# The signal of a fine bit has an error of this share of the contrast in addition to its noise. Its
# causes are indirect light that differs between pattern and inverse, texture within the pixel, and
# compression. In a real scan (the sea shell), a bit with a signal of 0.03, 0.08, 0.12 and 0.20 of
# the contrast is wrong in 37, 20, 6 and 2 % of the pixels for columns, and in 25, 8, 3 and 1 % for
# rows, for each of the four finest bits. A normal error of this share explains these numbers.
FINE_ERROR = 0.06
# Signals of the next coarser bit, as shares of the contrast. Below the first, blur has removed the
# signal of this bit; above the second, the signal of this bit is small only next to its edges.
BLURRED, SHARP = 0.5, 0.8


class GrayBits(NamedTuple):
    """The bits of an axis, with the values of `AxisPlan` and `DecodeSpec` that decoding needs.

    Each row of `bits` has the fields of a `Bit`.
    """

    bits: Int[np.ndarray, "bits 4"]
    first_px: np.float32
    cell_px: np.float32
    reach: np.float32
    doubt: np.float32
    fine_error: np.float32


class Light(NamedTuple):
    """The brightest and the darkest value of each pixel [DN], for a picture or one row."""

    high: Float32[np.ndarray, "*pixels"]
    low: Float32[np.ndarray, "*pixels"]


class Places(NamedTuple):
    """Projector positions of pixels along an axis [px], which kernels write.

    At first, `sigma` holds only the variance from uncertain bits [px^2]; the standard deviation
    replaces it. `rival` is the distance to the position that results if the uncertain bit (if
    any) is inverted.
    """

    place: Float32[np.ndarray, "h w"]
    sigma: Float32[np.ndarray, "h w"]
    rival: Float32[np.ndarray, "h w"]


@kernel(parallel=True, error_model="numpy")
def read_gray(stack, code, law, light, places, why):
    """Decode bits to the middle of the code value's cell, and write the position's uncertainty."""
    bits, coarse, variance, rival = code.bits, places.place, places.sigma, places.rival
    count, w = len(bits), coarse.shape[1]
    for y in numba.prange(len(coarse)):
        margin = np.empty((count, w), dtype=np.int32)
        value = np.zeros(w, dtype=np.int32)
        row = np.int64(y)  # Parallel loops have unsigned counters, for which numba recompiles.
        of_row = Light(light.high[y], light.low[y])
        _read_bits(stack, row, bits, of_row, margin, value)
        _weigh_doubts(code, law, of_row, margin, value, variance[y], rival[y], why[y])
        for x in range(w):
            middle = np.float32(value[x]) + np.float32(0.5)
            coarse[y, x] = code.first_px + code.cell_px * middle


@kernel(parallel=True)
def lose_bits(stack, bits, light, top, saturation_dn, why):
    """Mark pixels in which a bit is lost, because bit and inverse, or threshold, are saturated.

    If only the pattern is saturated and not its inverse, the bit is certain. Without an inverse, a
    saturated bright frame makes the threshold too low. The bits of wide stripes are still certain;
    in narrow stripes, which blur turns grey, only dark bits are certain.
    """
    high, low = light.high, light.low
    for y in numba.prange(len(why)):
        if not top[y].any():
            continue
        w = why.shape[1]
        glare = np.zeros(w, dtype=np.bool_)
        lost = np.zeros(w, dtype=np.bool_)
        for b in range(len(bits)):
            first, inverse = stack[bits[b, 0], y], bits[b, 1]
            for x in range(w):
                full = np.float32(first[x]) >= saturation_dn
                middle = np.float32(0.5) * (high[y, x] + low[y, x])
                second = np.float32(stack[inverse, y, x]) if inverse >= 0 else middle
                lost[x] |= full & (second >= saturation_dn)
                glare[x] |= full & (inverse < 0)
        for b in range(len(bits)):
            if bits[b, 1] >= 0 or (bits[b, 3] == 1 and bits[b, 2] < 0):
                continue
            first = stack[bits[b, 0], y]
            for x in range(w):
                lit = np.float32(2) * np.float32(first[x]) > high[y, x] + low[y, x]
                lost[x] |= glare[x] & lit
        for x in range(w):
            free = why[y, x] == Reason.DECODED
            why[y, x] = np.uint8(Reason.SATURATED) if lost[x] & free else why[y, x]


@kernel()
def _read_bits(stack, y, bits, light, margin, value):
    """Write the signal of each bit to `margin`, and add the bits to `value`, which starts at 0.

    A signal is pattern minus inverse or, without inverse, twice the distance to the threshold.
    """
    high, low = light.high, light.low
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
    for x in range(w):  # Convert Gray to binary by a prefix exclusive-or of up to 32 bits.
        word = value[x] ^ (value[x] >> np.int32(16))
        word ^= word >> np.int32(8)
        word ^= word >> np.int32(4)
        word ^= word >> np.int32(2)
        value[x] = word ^ (word >> np.int32(1))


@kernel(error_model="numpy")
def _weigh_doubts(code, law, light, margin, value, variance, rival, why):
    """Write the effect of uncertain bits: a variance [px^2], or a contradiction in `why`."""
    offset_dn, floor_dn2, slope_dn = law
    bits, cell_px, reach = code.bits, code.cell_px, code.reach
    doubt, fine_error, high, low = code.doubt, code.fine_error, light.high, light.low
    count, w = margin.shape
    zero, half, one, two = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
    noise = np.empty(w, dtype=np.float32)  # Noise of pattern minus inverse [DN]
    third = np.empty(w, dtype=np.float32)
    contrast = np.empty(w, dtype=np.float32)
    for x in range(w):
        light = max(high[x] + low[x] - two * offset_dn, zero)
        noise[x] = math.sqrt(two * floor_dn2 + slope_dn * light)
        third[x] = np.float32(1 / 3) / noise[x]
        contrast[x] = high[x] - low[x]
    counted = (bits[:, 3] == 1).sum()
    doubts = np.zeros((2, w), dtype=np.int32)
    bright = 0
    sure = np.empty((2, w), dtype=np.float32)
    scale_of_sure = zero
    for b in range(count):
        of_bit = margin[b]
        # Without an inverse the threshold is noisy: 2 I - (high + low) has 3 times the variance.
        paired = bits[b, 1] >= 0
        scale = one if paired else np.float32(1 / math.sqrt(3.0))
        flip = np.int32((2 << (count - 1 - b)) - 1)
        if fine_error > 0 and bits[b, 3] == 0 and bits[b, 2] < 0:
            if scale_of_sure != scale:
                scale_of_sure = scale
                _fine_limits(noise, contrast, fine_error, scale, sure)
            coarser = margin[b - 1] if b > 0 and bits[b - 1, 2] < 0 else of_bit[:0]
            _weigh_fine(of_bit, coarser, sure, flip, value, cell_px, variance)
            continue
        if bits[b, 3] == 0:
            for x in range(w):
                wrong = max(one - abs(np.float32(of_bit[x])) * (third[x] * scale), zero)
                apart_px = cell_px * (np.float32(np.int32(value[x] ^ flip)) - np.float32(value[x]))
                variance[x] += half * (wrong * wrong * wrong) * (apart_px * apart_px)
            continue
        of_half = doubts[0 if 2 * bright < counted else 1]
        bright += bits[b, 3] == 1
        counts = np.int32(bits[b, 3])
        combined = bits[b, 2] >= 0
        noisy = np.float32(XOR_SIGMAS) / scale if combined or counts > 1 else zero
        near = zero if combined else doubt
        far = np.float32(XOR_DOUBT) * doubt if combined else doubt
        for x in range(w):
            size = abs(np.float32(of_bit[x]))
            apart = np.float32(np.int32(value[x] ^ flip)) - np.float32(value[x])
            wrong = max(one - size * (third[x] * scale), zero)
            variance[x] += half * (wrong * wrong * wrong) * ((cell_px * apart) * (cell_px * apart))
            costly = abs(apart) > reach
            grave = max(counts, np.int32(1) + np.int32(costly))
            doubtful = size < max((far if costly else near) * contrast[x], noisy * noise[x])
            of_half[x] += grave if doubtful else np.int32(0)
            rival[x] = cell_px * apart if doubtful else rival[x]
    coarse, fine = doubts[0], doubts[1]
    for x in range(w):
        # Indirect light makes only coarse bits doubtful.
        spoilt, wrong = np.uint8(Reason.INTERREFLECTION), np.uint8(Reason.CONTRADICTORY)
        reason = spoilt if fine[x] == 0 else wrong
        free = why[x] == Reason.DECODED
        why[x] = reason if free & (coarse[x] + fine[x] >= 2) else why[x]


@kernel(error_model="numpy")
def _fine_limits(noise, contrast, fine_error, scale, sure):
    """Fill `sure` with two factors per pixel that normalise the signals of fine bits [1/DN].

    Row 0 is 1 / (3 sigma), where sigma combines noise and `fine_error * contrast`. Row 1 is
    1 / ((SHARP - BLURRED) * contrast); `_weigh_fine` uses it to judge blur from the coarser bit.
    """
    for x in range(len(noise)):
        noise_dn, off_dn = noise[x] / scale, fine_error * contrast[x]
        sure[0, x] = np.float32(1 / 3) / math.sqrt(noise_dn * noise_dn + off_dn * off_dn)
        sure[1, x] = np.float32(1 / (SHARP - BLURRED)) / contrast[x]


@kernel(error_model="numpy")
def _weigh_fine(of_bit, coarser, sure, flip, value, cell_px, variance):
    """Add the variance from a fine bit [px^2]; `coarser` is empty if the blur is unknown.

    If stripes are sharp, a small signal means that an edge of the bit is near, and the true
    position is between the two possible values. If blur has removed the signal, the true position
    is anywhere in one of the two cells.
    """
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    cell2 = half * cell_px * cell_px
    start = np.float32(BLURRED / (SHARP - BLURRED))
    third, per_span = sure[0], sure[1]
    if len(coarser) == 0:
        for x in range(len(of_bit)):
            wrong = max(one - abs(np.float32(of_bit[x])) * third[x], zero)
            apart = np.float32(np.int32(value[x] ^ flip) - value[x])
            square = half * apart * apart - np.float32(1 / 6)
            variance[x] += cell2 * (wrong * wrong * wrong) * square
        return
    for x in range(len(of_bit)):
        wrong = max(one - abs(np.float32(of_bit[x])) * third[x], zero)
        apart = np.float32(np.int32(value[x] ^ flip) - value[x])
        square = apart * apart
        beside = abs(np.float32(coarser[x])) * per_span[x] - start
        square -= min(max(beside, zero), one) * (half * square + np.float32(1 / 6))
        variance[x] += cell2 * (wrong * wrong * wrong) * square
