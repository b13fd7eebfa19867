"""Check the direction and the origin of phases with the Gray code of the same stack.

If steps are counted backwards, or from another origin, most phases are still in the right Gray cell
by chance, and are decoded to a wrong position. The edges of the Gray code reveal this.
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

BAND_PX = 8  # Height of a band of rows, in which pixels have neighbours in both directions.
LEAST = 200  # The fewest edges of cells that suffice to check the phases.
FAR_PERIODS = 0.25  # Neighbours whose cells are farther apart are on different surfaces.
SURE_SIGMAS = 5.0  # The certainty that is required to report that steps run backwards.
UNRELATED = 0.5  # Below this length of the mean vector, phases do not fit the edges at all.
ORIGIN_PERIODS = 0.04  # An origin this near to the stated one counts as equal.
USUAL_PERIODS = 0.02  # An origin is rounded to a step or a quarter of a period this near.


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edges:
    """Edges between two neighbouring pixels that see two adjacent Gray cells."""

    place: Float[np.ndarray, " n"]  # [periods]
    phase: Float[np.ndarray, " n"]  # The phase at the edge [periods], with the stated steps.
    forwards: float  # Mean of sin(change of phase) in the direction of increasing position.
    # Standard deviation of this mean, from its scatter; the changes are small if pixels are small.
    sigma: float

    @property
    def backwards(self) -> bool:
        """Whether the phase certainly decreases with increasing position."""
        return self.forwards < -SURE_SIGMAS * self.sigma

    @property
    def as_stated(self) -> bool:
        """Whether direction and origin are as stated."""
        origin, strength = self.origin(1)
        return not self.backwards and strength >= UNRELATED and abs(origin) <= ORIGIN_PERIODS

    def origin(self, sign: int) -> tuple[float, float]:
        """Return the origin [periods] of place = sign * phase + origin, and its certainty."""
        mean = np.exp(2j * np.pi * (self.place - sign * self.phase)).mean()
        return float(np.angle(mean) / (2 * np.pi)), float(abs(mean))

    def miss(self, sign: int, origin: float) -> float:
        """Return the median distance of the edges from their positions by phase [periods]."""
        apart = self.place - sign * self.phase - origin
        return float(np.median(np.abs(apart - np.rint(apart))))


@dataclass(frozen=True, slots=True, kw_only=True)
class GrayBands:
    """Bands of rows of a stack, and their positions by the Gray bits of one axis alone."""

    frames: Stack
    rows: Int[np.ndarray, " h"]  # Row numbers in the picture
    place_px: Float[np.ndarray, "h w"]  # The middle of the Gray cell; NaN if unknown

    def neighbours(self, value: Num[np.ndarray, "h w"]) -> Num[np.ndarray, "n 2"]:
        """Return the values of pairs of horizontal and vertical neighbours."""
        below = np.diff(self.rows) == 1
        pairs = [
            (value[:, :-1].ravel(), value[:, 1:].ravel()),
            (value[:-1][below].ravel(), value[1:][below].ravel()),
        ]
        return np.stack([np.concatenate(ends) for ends in zip(*pairs, strict=True)], axis=-1)

    def neighbour_places_px(self) -> Float[np.ndarray, "n 2"]:
        """Return the positions of neighbours if both are known."""
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
    """Decode the Gray bits of an axis in bands of rows that are spread over the picture."""
    rows = _rows(*well_lit.shape)
    stack = frames[:, rows]
    place_px = _gray_place_px(stack, code, axis, spec, levels)
    place_px[~well_lit[rows]] = np.nan
    return GrayBands(frames=stack, rows=rows, place_px=place_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseFault:
    """A warning about a period; `remedy` is true if the warning states the right steps."""

    text: str
    remedy: bool


def phase_faults(bands: GrayBands, code: Code, axis: Axis, plan: AxisPlan) -> Iterator[PhaseFault]:
    """Yield a warning for each period whose steps do not fit the Gray code of its axis.

    Between two neighbours in adjacent cells there is an edge with a known position, so the mean
    direction of exp 2 pi i (place / period - phase) over many edges is the origin. From one
    neighbour to the other, the phase must increase with the position, which determines the
    direction of the steps.

    Leaves out: codes without Gray bits. If all of their periods run backwards, the result is a
    mirror image, which only the other axis or a rig can reveal.
    """
    for period in plan.periods:
        if period.full:
            yield from _judge(bands, code, axis, plan, period)


def _rows(height: int, width: int) -> Int[np.ndarray, " n"]:
    """Return the rows of bands that are spread evenly over the picture."""
    bands = max(1, MAX_SAMPLES // (BAND_PX * width))
    if bands * BAND_PX >= height:
        return np.arange(height)
    first = np.linspace(0, height - BAND_PX, bands).astype(int)
    return np.unique(first[:, None] + np.arange(BAND_PX))


def _gray_place_px(
    stack: Stack, code: Code, axis: Axis, spec: DecodeSpec, levels: Levels
) -> Float[np.ndarray, "h w"]:
    """Return the middle of the cell to which the bits of one axis are decoded."""
    index = [
        k
        for k, f in enumerate(code.frames)
        if f.kind in ("white", "black") or (f.kind in ("gray", "complementary") and f.axis == axis)
    ]
    plan = plan_axes(code, spec.fine_bits)[axis]
    # Bits in a wrong order lead to positions beyond the projector, which are valid here.
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
    if len(wrong) == 2 and sorted(before) == sorted(after):  # Perhaps two were swapped.
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
    """Return whether there are enough edges of the Gray code, and the phases fit these edges."""
    edges = _edges(bands, _phase(bands, period), plan, period)
    return edges is not None and edges.as_stated


def _phase(bands: GrayBands, period: Period) -> Float[np.ndarray, "h w"]:
    """Return the phase of a period [periods], with the stated steps."""
    turns = np.tensordot(
        np.exp(1j * np.array(period.delta_rad)), bands.frames[list(period.frames)], axes=1
    )
    return np.angle(turns) / (2 * np.pi)


def _edges(
    bands: GrayBands, phase: Float[np.ndarray, "h w"], plan: AxisPlan, period: Period
) -> _Edges | None:
    """Return all pairs of neighbours with an edge of Gray cells between them.

    The result is None if there are too few pairs.
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
    """Round an origin to a near whole step or quarter of a period, which are the usual origins."""
    likely = [round(origin * n) / n for n in (steps, 4)]
    nearest = min(likely, key=lambda value: abs(value - origin))
    return nearest if abs(nearest - origin) <= USUAL_PERIODS else origin


def _listed(steps: list[float]) -> str:
    return ", ".join(f"{step:g}" for step in steps)
