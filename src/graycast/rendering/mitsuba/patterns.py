"""Store projector patterns in as few bits as possible, and sum the light of each pattern fast."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...rig.pair import Rig, emission
from ...rig.pattern import AXES, Axis


class PackedPatterns:
    """The light of all patterns, as 32-bit words for each projector pixel.

    A pattern takes one bit if all patterns are binary, eight bits with a linear response, and
    sixteen bits otherwise, with a rounding error of 1e-5.
    """

    def __init__(self, pattern: np.ndarray, rig: Rig):
        share = emission(rig, np.arange(256, dtype=np.uint8))
        if (pattern + np.uint8(1) <= 1).all():  # All are 0 or 255, as 255 wraps around to 0.
            bits = 1
        else:
            bits = 8 if np.allclose(share * 255, np.arange(256), rtol=0, atol=1e-9) else 16
        self.count, self._bits, self._most = len(pattern), bits, 2**bits - 1
        self._per_word = 32 // bits
        level = mi.UInt32(np.rint(share * self._most).astype(np.uint32))
        self._words = []
        for first in range(0, len(pattern), self._per_word):
            word = mi.UInt32(0)
            for k, image in enumerate(pattern[first : first + self._per_word]):
                grey = mi.UInt32(mi.UInt8(aligned(image)))
                word |= dr.gather(mi.UInt32, level, grey) << k * bits
            self._words.append(word)
        dr.eval(self._words)

    def levels(self, pixel: mi.UInt32, lit: mi.Bool) -> list[mi.Float]:
        """Return the light of each pattern at a pixel, from 0 to 1; 0 if not `lit`."""
        words = [dr.gather(mi.UInt32, word, pixel, lit) for word in self._words]
        shifted = (
            words[k // self._per_word] >> k % self._per_word * self._bits for k in range(self.count)
        )
        return [mi.Float(level & self._most) / self._most for level in shifted]

    def add(
        self, sums: list[mi.Float], light: mi.Float, pixels: list[mi.UInt32], lit: list[mi.Bool]
    ) -> None:
        """Add to the sum of each pattern `light` times its levels at the pixels."""
        for first in range(0, self.count, self._per_word):
            word = self._words[first // self._per_word]
            levels = [
                dr.gather(mi.UInt32, word, pixel, one)
                for pixel, one in zip(pixels, lit, strict=True)
            ]
            used = min(self._per_word, self.count - first) * self._bits
            shifts = range(0, used, self._bits)
            if self._bits == 1:
                planes = bit_counts(levels)
                shares = [light * 2**i for i in range(len(planes))]
                for k, shift in enumerate(shifts, start=first):
                    for plane, share in zip(planes, shares, strict=True):
                        sums[k] += dr.select((plane & (1 << shift)) != 0, share, 0)
            else:
                share = light / self._most
                for k, shift in enumerate(shifts, start=first):
                    total = sum((level >> shift) & self._most for level in levels)
                    sums[k] += share * mi.Float(total)


@dataclass(frozen=True, slots=True, kw_only=True)
class FinePattern:
    """A pattern's number, and the mean and standard deviation of its light."""

    number: int
    mean: float
    deviation: float


def finest_patterns(pattern: np.ndarray, rig: Rig) -> dict[Axis, FinePattern]:
    """Return, for each axis, the pattern whose light varies most along it.

    An axis along which no pattern varies is left out of the result.
    """
    finest: dict[Axis, FinePattern] = {}
    middle = pattern[:, pattern.shape[1] // 2, :], pattern[:, :, pattern.shape[2] // 2]
    for axis, line in zip(AXES, middle, strict=True):
        light = emission(rig, line)
        change = np.abs(np.diff(light, axis=1)).sum(axis=1)
        if change.max(initial=0) > 0:
            number = int(change.argmax())
            mean, deviation = float(light[number].mean()), float(light[number].std())
            finest[axis] = FinePattern(number=number, mean=mean, deviation=deviation)
    return finest


def aligned(values: np.ndarray) -> np.ndarray:
    """Return a flat copy that is aligned to 64 bytes.

    Dr.Jit uses NumPy's memory directly, and compiles another kernel for another alignment.
    """
    room = np.empty(values.nbytes + 64, dtype=np.uint8)
    first = -room.ctypes.data % 64
    copy = room[first : first + values.nbytes].view(values.dtype)
    copy[:] = values.ravel()
    return copy


def bit_counts(words: list[mi.UInt32]) -> list[mi.UInt32]:
    """Count how many of one, three or six words have each of the 32 bits set.

    Word k of the result has bit k of each count, from the lowest bit on. Full adders count all 32
    bits at once, so a pattern costs as many additions as its count has bits.
    """
    if len(words) == 1:
        return words
    ones, twos = _add(*words[:3])
    if len(words) == 3:
        return [ones, twos]
    others, carry = _add(*words[3:])
    return [ones ^ others, *_add(twos, carry, ones & others)]


def _add(a: mi.UInt32, b: mi.UInt32, c: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    return a ^ b ^ c, (a & b) | (c & (a ^ b))
