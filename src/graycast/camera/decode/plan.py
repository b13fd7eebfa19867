"""The interpretation of a list of frames: the bits and the phases of each axis.

All errors in a list of frames are detected here, before any pixel is decoded.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import DecodeError
from ...rig.pattern import AXES, Axis, Code, Frame

NO_FRAME = -1
# A Gray code's cell has at most this share of the length over which phases are unique. The rest is
# a margin for errors, half of it at each edge of the cell.
MAX_CELL = 0.75
# A position may be outside the Gray code's cell by this share of the length of unique phases.
OFF_CELL = 0.125
SAME_PERIODS = 0.002  # Tolerance [periods] for a common repetition of periods of rounded length.
# Phases have errors in addition to noise: with three steps and a non-linear projector they reach
# some tenths of a radian, which matters if the phases of two positions differ by so little.
MODEL_RAD = 0.05
# If Gray bits leave few positions, the error may be this share of their difference in phase: three
# times this error is just half of the way to the point where the next position fits better.
MODEL_SHARE = 1 / 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Bit:
    """One bit: its frame, its inverse's frame, and the index of the bit with which it is XORed."""

    frame: int
    inverse: int = NO_FRAME
    xor: int = NO_FRAME
    counts: int = 1  # Weight of a doubt in this bit; a pixel with a sum of 2 is contradictory.


@dataclass(frozen=True, slots=True, kw_only=True)
class Period:
    """The frames of one period: their indices, and the phase at which each is brightest [rad].

    Three or more frames, evenly spread, determine a phase; fewer need the mean and amplitude of
    the first period of the axis.
    """

    period_px: float
    frames: tuple[int, ...]
    delta_rad: tuple[float, ...]

    @property
    def full(self) -> bool:
        return len(self.frames) >= 3


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisPlan:
    """The plan of one axis, with bits from coarse to fine.

    Next to an edge of its stripes a bit may be misread, which changes the code value only a little.
    A doubtful bit that would change the value by more than `reach` is a contradiction.
    """

    size_px: int
    bits: tuple[Bit, ...]
    first_px: float  # The pixel border at which value 0 begins
    cell_px: float  # The width of a value of the Gray code
    reach: int
    periods: tuple[Period, ...]  # Full periods come first, beginning with the shortest.
    half_px: float  # Largest distance of a position from the middle of its cell or the projector
    model_rad: float  # Error of phases in addition to their noise

    @property
    def gray_counts(self) -> bool:
        """Whether the Gray code alone counts the first period."""
        return bool(self.bits) and self.cell_px <= MAX_CELL * self.periods[0].period_px


def read_frames(plans: dict[Axis, AxisPlan], count: int) -> Bool[np.ndarray, " n"]:
    """Return a mask of the frames that determine positions: all if a bit has no inverse."""
    read = np.zeros(count, dtype=bool)
    for plan in plans.values():
        for bit in plan.bits:
            read[[bit.frame, bit.inverse]] = True
            if bit.inverse == NO_FRAME:
                read[:] = True
        for period in plan.periods:
            read[list(period.frames)] = True
    return read


def plan_axes(code: Code, fine_bits: int) -> dict[Axis, AxisPlan]:
    """Return the plan of each coded axis.

    Raises:
        DecodeError: frames are missing or do not fit together; the message names them.
    """
    return {axis: _plan_axis(code, axis, fine_bits) for axis in code.axes}


def _plan_axis(code: Code, axis: Axis, fine_bits: int) -> AxisPlan:
    i = AXES.index(axis)
    indexed = [(k, f) for k, f in enumerate(code.frames) if f.axis == axis]
    periods = _periods(axis, indexed)
    lowest = min((f.bit for _, f in indexed if f.kind == "gray"), default=0)
    cell_px = code.stride_px[i] * 2.0**lowest
    if periods:  # Bits are fine if their stripes are narrower than half a period.
        fine_bits = max(0, math.floor(math.log2(0.5 * periods[0].period_px / cell_px) + 1e-9))
    bits = _gray_bits(axis, indexed, fine_bits)
    bits, cell_px = _with_complementary(axis, indexed, bits, cell_px)
    reach_px = cell_px * 2 ** len(bits) + code.offset_px[i]
    # A code that begins inside the picture is meant for only a part of the picture.
    if bits and code.offset_px[i] <= 0 and reach_px < code.size_px(axis) - 0.5:
        raise DecodeError(
            f"{axis}: {len(bits)} Gray bits of {cell_px:g} px reach {reach_px:g} px, the "
            f"projector has {code.size_px(axis)}: add the coarsest bit, or state stride_px"
        )
    half_px, model_rad = _search(code, axis, cell_px if bits else 0.0, periods)
    return AxisPlan(
        size_px=code.size_px(axis),
        bits=bits,
        first_px=code.offset_px[i] - 0.5,
        cell_px=cell_px,
        reach=2**fine_bits,
        periods=periods,
        half_px=half_px,
        model_rad=model_rad,
    )


def _search(
    code: Code, axis: Axis, cell_px: float, periods: tuple[Period, ...]
) -> tuple[float, float]:
    """Return the largest distance of a position from its cell's middle, and its phases' error.

    Gray code and phases together must leave only one position; `cell_px` is 0 without Gray code.
    """
    size_px = float(code.size_px(axis))
    if not periods:
        return 0.0, 0.0
    full_px = np.array([p.period_px for p in periods if p.full], dtype=np.float64)
    phases = f"the phases of period {' and '.join(f'{p:g}' for p in full_px)} px"
    unique_px = _unique_px(full_px, size_px)
    if cell_px > MAX_CELL * unique_px:
        raise DecodeError(
            f"{axis}: Gray values {cell_px:g} px wide cannot count {phases}, which repeat every "
            f"{unique_px:g} px: add a complementary bit, a finer Gray bit or another period"
        )
    if cell_px:
        half_px = 0.5 * cell_px + OFF_CELL * unique_px
        return half_px, _model_rad(full_px, 2 * half_px)
    if len(periods) == 1 and unique_px < size_px:
        raise DecodeError(
            f"{axis}: {phases} repeat within the projector's {size_px:g} px; add Gray bits or "
            "other periods to count them"
        )
    return 0.5 * size_px, MODEL_RAD


def _gray_bits(axis: Axis, indexed: list[tuple[int, Frame]], fine_bits: int) -> tuple[Bit, ...]:
    """Return the bits from coarse to fine; the finest one need not be bit 0."""
    frame_of = {f.bit: (k, f) for k, f in indexed if f.kind == "gray" and not f.inverse}
    inverse = {f.bit: k for k, f in indexed if f.kind == "gray" and f.inverse}
    lone = sorted(set(inverse) - set(frame_of))
    if lone:
        raise DecodeError(f"{axis}: bit {lone[0]} has an inverse but no frame of its own")
    if not frame_of:
        return ()
    numbers = sorted(frame_of, reverse=True)
    gaps = sorted(set(range(numbers[-1], numbers[0])) - set(numbers))
    if gaps:
        raise DecodeError(f"{axis}: Gray bit {gaps[0]} is missing between finer and coarser bits")
    bases = {frame.xor_bit for _, frame in frame_of.values()}
    bits = []
    for number in numbers:
        k, frame = frame_of[number]
        base = NO_FRAME
        if frame.xor_bit >= 0:
            if frame.xor_bit not in frame_of or frame_of[frame.xor_bit][1].xor_bit >= 0:
                raise DecodeError(
                    f"{axis}: bit {number} is combined with bit {frame.xor_bit}, which the code "
                    "must also have uncombined"
                )
            base = numbers.index(frame.xor_bit)
        counts = int(number - numbers[-1] >= fine_bits or frame.xor_bit >= 0)
        if number in bases:  # If this bit is misread, all bits combined with it are wrong.
            counts = 2
        bits.append(Bit(frame=k, inverse=inverse.get(number, NO_FRAME), xor=base, counts=counts))
    return tuple(bits)


def _with_complementary(
    axis: Axis,
    indexed: list[tuple[int, Frame]],
    bits: tuple[Bit, ...],
    cell_px: float,
) -> tuple[tuple[Bit, ...], float]:
    """Append the complementary bit if the cells of the Gray code are whole periods.

    A finer Gray code does not need this bit. Return the bits and the width of a cell [px].
    """
    frame_of = {f.inverse: (k, f) for k, f in indexed if f.kind == "complementary"}
    if len([1 for _, f in indexed if f.kind == "complementary"]) > len(frame_of):
        raise DecodeError(f"{axis}: the code has more than one complementary bit: give one")
    if not frame_of:
        return bits, cell_px
    if False not in frame_of:
        raise DecodeError(
            f"{axis}: the complementary bit has an inverse frame but no frame of its own"
        )
    k, frame = frame_of[False]
    if not bits:
        raise DecodeError(
            f"{axis}: the code has a complementary bit but no Gray bits: add the Gray bits"
        )
    if cell_px <= 0.5 * frame.period_px:
        return bits, cell_px
    if abs(cell_px - frame.period_px) > 1e-6 * cell_px:
        raise DecodeError(
            f"{axis}: the complementary bit halves {frame.period_px:g} px, the Gray values are "
            f"{cell_px:g} px wide: stride_px must be the period"
        )
    inverse = frame_of[True][0] if True in frame_of else NO_FRAME
    return (*bits, Bit(frame=k, inverse=inverse)), cell_px / 2


def _periods(axis: Axis, indexed: list[tuple[int, Frame]]) -> tuple[Period, ...]:
    groups: dict[tuple[float, int], list[tuple[int, Frame]]] = {}
    for k, frame in indexed:
        if frame.kind in ("phase", "line"):
            groups.setdefault((frame.period_px, frame.steps), []).append((k, frame))
    periods = []
    for (period_px, steps), members in groups.items():
        if 3 <= len(members) < steps or (len(members) == 2):
            there = {f.step for _, f in members}
            missing = ", ".join(str(s) for s in range(steps) if s not in there)
            raise DecodeError(f"{axis}: period {period_px:g} px lacks step {missing} of {steps}")
        members.sort(key=lambda member: member[1].step)
        periods.append(
            Period(
                period_px=period_px,
                frames=tuple(k for k, _ in members),
                delta_rad=tuple(2 * np.pi * f.step / steps for _, f in members),
            )
        )
    periods.sort(key=lambda p: (not p.full, p.period_px))
    if periods and not periods[0].full:
        raise DecodeError(
            f"{axis}: no period has all its steps; give at least one period with all its steps"
        )
    return tuple(periods)


def _unique_px(full_px: Float[np.ndarray, " n"], size_px: float) -> float:
    """Return the distance after which the phases of all periods repeat, at most `size_px`."""
    apart_px, turns = _same_first_phase(full_px, size_px)
    repeats = (np.abs(turns) <= SAME_PERIODS).all(axis=1)
    return float(apart_px[repeats].min(initial=size_px))


def _model_rad(full_px: Float[np.ndarray, " n"], span_px: float) -> float:
    """Return the largest phase error, at least `MODEL_RAD`, that keeps positions distinct."""
    _, turns = _same_first_phase(full_px, span_px)
    nearest = float(np.linalg.norm(turns, axis=1).min(initial=0.5))
    return max(MODEL_RAD, MODEL_SHARE * 2 * math.pi * nearest)


def _same_first_phase(full_px: Float[np.ndarray, " n"], span_px: float):
    """Return the multiples of the first period, and each period's difference in phase [turns]."""
    apart_px = full_px[0] * np.arange(1, math.floor(span_px / full_px[0]) + 1)
    turns = apart_px[:, None] / full_px
    return apart_px, turns - np.rint(turns)
