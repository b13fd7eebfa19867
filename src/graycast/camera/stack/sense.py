"""Direction and origin of the phases of a stack, compared with its Gray code.

A phase whose steps are counted backwards, or from another origin, still lies in the right Gray cell
by chance at most pixels, and decodes to a wrong place. The Gray code knows better.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Num

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
    # The deviation of this mean, from its scatter: a camera of small pixels sees small changes.
    sigma: float

    @property
    def backwards(self) -> bool:
        """Whether the phase surely falls where the place grows."""
        return self.forwards < -SURE_SIGMAS * self.sigma

    @property
    def as_stated(self) -> bool:
        """Whether sense and origin are the stated ones."""
        origin, strength = self.origin(1)
        return not self.backwards and strength >= UNRELATED and abs(origin) <= ORIGIN_PERIODS

    def origin(self, sign: int) -> tuple[float, float]:
        """Return the origin [periods] of place = sign * phase + origin, and its certainty."""
        mean = np.exp(2j * np.pi * (self.place - sign * self.phase)).mean()
        return float(np.angle(mean) / (2 * np.pi)), float(abs(mean))

    def miss(self, sign: int, origin: float) -> float:
        """Median distance of the phases' places from the edges [periods]."""
        apart = self.place - sign * self.phase - origin
        return float(np.median(np.abs(apart - np.rint(apart))))


@dataclass(frozen=True, slots=True, kw_only=True)
class GrayBands:
    """Bands of rows of a stack, and the places that the Gray bits of one axis alone say there."""

    frames: Stack
    rows: Int[np.ndarray, " h"]  # the numbers of the rows
    place_px: Float[np.ndarray, "h w"]  # the middle of the Gray value; NaN where nothing is known

    def neighbours(self, value: Num[np.ndarray, "h w"]) -> Num[np.ndarray, "n 2"]:
        """Return values of pixels beside and below one another."""
        below = np.diff(self.rows) == 1
        pairs = [
            (value[:, :-1].ravel(), value[:, 1:].ravel()),
            (value[:-1][below].ravel(), value[1:][below].ravel()),
        ]
        return np.stack([np.concatenate(ends) for ends in zip(*pairs, strict=True)], axis=-1)

    def neighbour_places_px(self) -> Float[np.ndarray, "n 2"]:
        """Return places of neighbours that are both known."""
        pairs_px = self.neighbours(self.place_px)
        return pairs_px[np.isfinite(pairs_px).all(axis=-1)]


def gray_bands(
    frames: Stack,
    code: Code,
    axis: Axis,
    spec: DecodeSpec,
    levels: Levels,
    well_lit: Bool[np.ndarray, "h w"],
) -> GrayBands:
    """Return what the Gray bits of an axis say, in bands of rows over the whole picture."""
    rows = _rows(*well_lit.shape)
    stack = frames[:, rows]
    place_px = _gray_place_px(stack, code, axis, spec, levels)
    place_px[~well_lit[rows]] = np.nan
    return GrayBands(frames=stack, rows=rows, place_px=place_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseFault:
    """A warning of a period, and whether it says which steps are right."""

    text: str
    remedy: bool


def phase_faults(bands: GrayBands, code: Code, axis: Axis, plan: AxisPlan) -> Iterator[PhaseFault]:
    """Yield a warning for each period whose steps do not run as the Gray code of its axis says.

    Two neighbours in cells side by side see the edge between them, whose place is known, so the
    mean direction of exp 2 pi i (place / period - phase) over many edges is the origin: all are
    tried at once. From one neighbour to the other the phase grows where the place does; this tells
    the sense, which cells of half a period cannot.

    Leaves out: codes whose periods count one another; without Gray bits a sense that is wrong
    for all periods gives a mirror image, which only the other axis or a rig can tell.
    """
    for period in plan.periods:
        if period.full:
            yield from _judge(bands, code, axis, plan, period)


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
    plan = plan_axes(code, spec.fine_bits)[axis]
    # Bits in a wrong order say places beyond the projector, which are places, too.
    reach_px = max(2, math.floor(plan.first_px + 0.5 + plan.cell_px * 2 ** len(plan.bits)))
    size_px = {"width_px" if axis == "column" else "height_px": reach_px}
    bits = replace(code, frames=tuple(code.frames[k] for k in index), **size_px)
    codes = decode(stack[index], bits, spec, levels)
    place_px = codes.column if axis == "column" else codes.row
    return np.where(codes.reason == Reason.DECODED, place_px, np.nan).astype(np.float64)


def _judge(
    bands: GrayBands, code: Code, axis: Axis, plan: AxisPlan, period: Period
) -> Iterator[PhaseFault]:
    phase = _phase(bands, period)
    edges = _edges(bands, phase, plan, period)
    if edges is None or edges.as_stated:
        return
    sign = -1 if edges.backwards else 1
    origin, strength = edges.origin(sign)
    px = period.period_px
    whose = f"the phases of period {px:g} px do not fit the Gray code of the {axis}s"
    if strength < UNRELATED:
        text = (
            f"{whose} in any direction or from any origin (off by {px * edges.miss(1, 0.0):.2g} "
            "px at the edges of its values): check period_px and the order of the frames"
        )
        yield PhaseFault(text=text, remedy=False)
        return
    steps = code.frames[period.frames[0]].steps
    before = [float(code.frames[k].step) for k in period.frames]
    origin = _usual(origin, steps)
    after = [round((sign * step + origin * steps) % steps, 2) % steps for step in before]
    usable_phase = phase[np.isfinite(bands.place_px)]
    moved = (1 - sign) * usable_phase - origin
    wrong = [k for k, one, other in zip(period.frames, before, after, strict=True) if one != other]
    cause = "the steps run backwards" if sign < 0 else "the steps run from another origin"
    if len(wrong) == 2 and sorted(before) == sorted(after):  # so two pictures in each other's place
        both = " and ".join(code.frames[k].name for k in wrong)
        cause = f"{both} may be exchanged, or {cause}"
    text = (
        f"{whose}: {cause}. With step "
        f"{_listed(after)} of {steps} instead of {_listed(before)} they meet the edges of its "
        f"values within {px * edges.miss(sign, origin):.2g} px, and places move by "
        f"{px * float(np.median(np.abs(moved - np.rint(moved)))):.2g} px (medians)"
    )
    yield PhaseFault(text=text, remedy=True)


def phases_agree(bands: GrayBands, plan: AxisPlan, period: Period) -> bool:
    """Return whether enough edges of the Gray code are seen, and the phases run as these say."""
    edges = _edges(bands, _phase(bands, period), plan, period)
    return edges is not None and edges.as_stated


def _phase(bands: GrayBands, period: Period) -> Float[np.ndarray, "h w"]:
    """Return the phase of a period [periods], as the stated steps make it."""
    turns = np.tensordot(
        np.exp(1j * np.array(period.delta_rad)), bands.frames[list(period.frames)], axes=1
    )
    return np.angle(turns) / (2 * np.pi)


def _edges(
    bands: GrayBands, phase: Float[np.ndarray, "h w"], plan: AxisPlan, period: Period
) -> _Edges | None:
    """Return all pairs of neighbours with an edge of the Gray cells between them.

    None where they are too few.
    """
    place, cell = bands.place_px / period.period_px, plan.cell_px / period.period_px
    first, second = bands.neighbours(place).T
    before, after = bands.neighbours(phase).T
    apart = second - first
    with np.errstate(invalid="ignore"):
        beside = (apart != 0) & (np.abs(apart) <= max(cell, FAR_PERIODS) + 1e-6)
    if beside.sum() < LEAST:
        return None
    change = after[beside] - before[beside]
    change -= np.rint(change)
    forwards = np.sign(apart[beside]) * np.sin(2 * np.pi * change)
    return _Edges(
        place=(first + second)[beside] / 2,
        phase=before[beside] + change / 2,
        forwards=float(forwards.mean()),
        sigma=float(forwards.std() / math.sqrt(len(forwards))),
    )


def _usual(origin: float, steps: int) -> float:
    """A whole step or a quarter of a period, where one is near: that is what programs write."""
    likely = [round(origin * n) / n for n in (steps, 4)]
    nearest = min(likely, key=lambda value: abs(value - origin))
    return nearest if abs(nearest - origin) <= USUAL_PERIODS else origin


def _listed(steps: list[float]) -> str:
    return ", ".join(f"{step:g}" for step in steps)
