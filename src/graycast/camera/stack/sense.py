"""Direction and origin of the phases of a stack, compared with its Gray code.

A phase whose steps are counted backwards, or from another origin, still lies in the right Gray cell
by chance at most pixels, and decodes to a wrong place. The Gray code knows better.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...rig.pattern import Axis, Code
from ..decode import DecodeSpec, Levels, Reason, decode
from ..decode.plan import AxisPlan, Period, plan_axes
from .levels import Stack
from .stack_figures import MAX_SAMPLES

BAND_PX = 8  # Rows are read together, so that neighbours are there in both directions.
LEAST = 200  # Fewer edges of cells are too few to judge the phases.
FAR_PERIODS = 0.25  # Neighbours whose cells are farther apart lie on different surfaces.
SURE_SIGMAS = 5.0  # Neighbours must say by this much that the steps run backwards.
UNRELATED = 0.5  # Below this resultant the phases at the edges are anywhere.
ORIGIN_PERIODS = 0.04  # An origin this near is the stated one.
USUAL_PERIODS = 0.02  # An origin this near to a whole step or a quarter of a period is that.


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edges:
    """Where one neighbour sees one Gray cell and the other the next, which is between the two."""

    place: Float[np.ndarray, " n"]  # [periods]
    phase: Float[np.ndarray, " n"]  # It is the phase there [periods], as the stated steps make it.
    forwards: float  # It is the mean of sin(change of phase) towards higher places.

    @property
    def backwards(self) -> bool:
        """Whether the phase surely falls where the place grows."""
        return self.forwards < -SURE_SIGMAS * math.sqrt(0.5 / len(self.place))

    def origin(self, sign: int) -> tuple[float, float]:
        """Of place = sign * phase + origin [periods], and how well it holds, 0 to 1."""
        mean = np.exp(2j * np.pi * (self.place - sign * self.phase)).mean()
        return float(np.angle(mean) / (2 * np.pi)), float(abs(mean))

    def miss(self, sign: int, origin: float) -> float:
        """Median distance of the phases' places from the edges [periods]."""
        apart = self.place - sign * self.phase - origin
        return float(np.median(np.abs(apart - np.rint(apart))))


def phase_faults(
    frames: Stack,
    code: Code,
    spec: DecodeSpec,
    levels: Levels,
    well_lit: Bool[np.ndarray, "h w"],
) -> Iterator[str]:
    """A warning for each period whose steps do not run as the Gray code of the same axis says.

    Two neighbours in cells side by side see the edge between them, whose place is known, so the
    mean direction of exp 2 pi i (place / period - phase) over many edges is the origin: all are
    tried at once. From one neighbour to the other the phase grows where the place does; this tells
    the sense, which cells of half a period cannot.

    Leaves out: codes whose periods count one another; without Gray bits a sense that is wrong
    for all periods gives a mirror image, which only the other axis or a rig can tell.
    """
    rows = _rows(*well_lit.shape)
    stack, usable = frames[:, rows], well_lit[rows]
    for axis, plan in plan_axes(code, spec.fine_bits).items():
        if not (plan.bits and plan.periods):
            continue
        place_px = _gray_place_px(stack, code, axis, spec, levels)
        place_px[~usable] = np.nan
        for period in plan.periods:
            if period.full:
                yield from _judge(stack, rows, place_px, code, axis, plan, period)


def _rows(height: int, width: int) -> Int[np.ndarray, " n"]:
    """Bands of rows, evenly over the picture."""
    bands = max(1, MAX_SAMPLES // (BAND_PX * width))
    if bands * BAND_PX >= height:
        return np.arange(height)
    first = np.linspace(0, height - BAND_PX, bands).astype(int)
    return np.unique(first[:, None] + np.arange(BAND_PX))


def _gray_place_px(
    stack: Stack, code: Code, axis: Axis, spec: DecodeSpec, levels: Levels
) -> Float[np.ndarray, "h w"]:
    """Middle of the cell that the bits of one axis alone say."""
    index = [
        k
        for k, f in enumerate(code.frames)
        if f.kind in ("white", "black") or (f.kind in ("gray", "complementary") and f.axis == axis)
    ]
    bits = replace(code, frames=tuple(code.frames[k] for k in index))
    codes = decode(stack[index], bits, spec, levels)
    place_px = codes.column if axis == "column" else codes.row
    return np.where(codes.reason == Reason.DECODED, place_px, np.nan).astype(np.float64)


def _judge(
    stack: Stack, rows, place_px, code: Code, axis: Axis, plan: AxisPlan, period: Period
) -> Iterator[str]:
    turns = np.tensordot(
        np.exp(1j * np.array(period.delta_rad)), stack[list(period.frames)], axes=1
    )
    place, phase = place_px / period.period_px, np.angle(turns) / (2 * np.pi)
    edges = _edges(place, phase, rows, plan.cell_px / period.period_px)
    if edges is None:
        return
    sign = -1 if edges.backwards else 1
    origin, strength = edges.origin(sign)
    if sign > 0 and strength >= UNRELATED and abs(origin) <= ORIGIN_PERIODS:
        return
    px = period.period_px
    whose = f"the phases of period {px:g} px do not fit the Gray code of the {axis}s"
    if strength < UNRELATED:
        yield (
            f"{whose} in any direction or from any origin (off by {px * edges.miss(1, 0.0):.2g} "
            "px at the edges of its values): check period_px and the order of the frames"
        )
        return
    steps = code.frames[period.frames[0]].steps
    before = [float(code.frames[k].step) for k in period.frames]
    origin = _usual(origin, steps)
    after = [round((sign * step + origin * steps) % steps, 2) % steps for step in before]
    usable_phase = phase[np.isfinite(place)]
    moved = (1 - sign) * usable_phase - origin
    yield (
        f"{whose}: the steps run {'backwards' if sign < 0 else 'from another origin'}. With step "
        f"{_listed(after)} of {steps} instead of {_listed(before)} they meet the edges of its "
        f"values within {px * edges.miss(sign, origin):.2g} px, and places move by "
        f"{px * float(np.median(np.abs(moved - np.rint(moved)))):.2g} px (medians)"
    )


def _edges(place, phase, rows, cell: float) -> _Edges | None:
    """All pairs of neighbours with an edge of the Gray cells between them; None of too few."""
    below = np.diff(rows) == 1
    pairs = [
        (place[:, :-1], place[:, 1:], phase[:, :-1], phase[:, 1:]),
        (place[:-1][below], place[1:][below], phase[:-1][below], phase[1:][below]),
    ]
    first, second, before, after = (
        np.concatenate([pair[k].ravel() for pair in pairs]) for k in range(4)
    )
    apart = second - first
    with np.errstate(invalid="ignore"):
        beside = (apart != 0) & (np.abs(apart) <= max(cell, FAR_PERIODS) + 1e-6)
    if beside.sum() < LEAST:
        return None
    change = after[beside] - before[beside]
    change -= np.rint(change)
    return _Edges(
        place=(first + second)[beside] / 2,
        phase=before[beside] + change / 2,
        forwards=float((np.sign(apart[beside]) * np.sin(2 * np.pi * change)).mean()),
    )


def _usual(origin: float, steps: int) -> float:
    """A whole step or a quarter of a period, where one is near: that is what programs write."""
    likely = [round(origin * n) / n for n in (steps, 4)]
    nearest = min(likely, key=lambda value: abs(value - origin))
    return nearest if abs(nearest - origin) <= USUAL_PERIODS else origin


def _listed(steps: list[float]) -> str:
    return ", ".join(f"{step:g}" for step in steps)
