"""Detect two exchanged pictures of a period: the grey levels are then no sine over the steps.

With a wrong direction or origin of the steps the levels are still a sine, but seldom after an
exchange of two pictures out of four or more. An exchange can also look like another origin, or like
single steps that are brighter, because some of the phases are nearly right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from ...rig.pattern import Axis, Code
from ..decode import DecodeSpec, Levels
from ..decode.plan import AxisPlan, Period
from .levels import Stack
from .sense import gray_bands, phases_agree
from .stack_figures import WELL, samples
from .stack_pictures import StackPictures

FEWEST, MOST = 500, 20_000  # The fewest pixels that are enough, and the most that are used.
# In the right order, the squared difference from a sine is less than this share of the difference
# in the stated order (half the share if the pattern is binary stripes). If the stated order is
# right, no exchange reduces the difference.
LEFT = 0.6
CLEARLY = (
    0.4  # The best order must have less than this share of the second-best order's difference.
)
ALIKE = 1.01  # Orders whose differences agree within this factor are equally good.
ROUNDING = 1e-9  # Differences below this share of the squared contrast are rounding errors.

Pair = tuple[int, int]  # Two positions in the sequence of steps


@dataclass(frozen=True, slots=True, kw_only=True)
class StepExchange:
    """A period in which two pictures are exchanged: its frames, and a warning with both names."""

    frames: tuple[int, ...]
    text: str


def step_exchanges(
    pictures: StackPictures,
    code: Code,
    plans: dict[Axis, AxisPlan],
    spec: DecodeSpec,
    levels: Levels,
) -> list[StepExchange]:
    """Return the periods in which two pictures are exchanged.

    With four to six steps, the exchange of either of two pairs gives the same sine, in opposite
    directions. The edges of the Gray code decide; without Gray bits the warning names both pairs.

    Leaves out: periods of three steps, where an exchange is the same as another direction or
    origin; shifted lines, which are no sines.
    """
    sines = [
        (axis, period)
        for axis, plan in plans.items()
        for period in plan.periods
        if period.full and code.frames[period.frames[0]].kind == "phase"
    ]
    if not sines:
        return []
    frames, exchanges = pictures.frames, []
    clear = _clear(frames)
    names = [f"{f.name} ({file.name})" for f, file in zip(code.frames, pictures.files, strict=True)]
    for axis, period in sines:
        pairs, left = _sine_pairs(frames, period, clear, levels.saturation_dn)
        if len(pairs) > 1 and plans[axis].bits:
            bands = gray_bands(frames, code, axis, spec, levels, clear)
            agreeing = [p for p in pairs if phases_agree(bands, plans[axis], _exchanged(period, p))]
            pairs = agreeing or pairs
        if pairs:
            text = _describe(axis, period, pairs, left, names)
            exchanges.append(StepExchange(frames=period.frames, text=text))
    return exchanges


def _clear(frames: Stack) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels with a good contrast between frames, in any order of frames.

    The modulation of decoded codes is not suitable: in a wrong order it depends on the phase, so
    that whole ranges of phases, with the edges of Gray values there, would be missing.
    """
    contrast = (frames.max(axis=0) - frames.min(axis=0)).astype(np.float32)
    return (contrast > 0) & (contrast >= WELL * np.percentile(contrast, 98))


def _sine_pairs(
    frames: Stack, period: Period, clear: Bool[np.ndarray, "h w"], saturation_dn: float
) -> tuple[list[Pair], float]:
    """Return the pairs after whose exchange the grey levels are nearest to a sine over the steps.

    The difference from a sine follows from the sums of products of the pictures, which are
    computed only once for all pairs.

    Returns:
        The pairs (none if no exchange clearly reduces the difference), and the remaining share of
        the squared difference.
    """
    value = frames[list(period.frames)].reshape(len(period.frames), -1)[:, samples(clear)]
    value = value[:, value.max(axis=0) < saturation_dn]
    value = value[:, :: max(1, value.shape[1] // MOST)].astype(np.float64)
    pairs = [*combinations(range(len(value)), 2)]
    if value.shape[1] < FEWEST or any(np.array_equal(value[a], value[b]) for a, b in pairs):
        return [], 1.0  # Two equal pictures are another fault, which has its own warning.
    value -= value.mean(axis=0)
    off_sine, products = _off_sine(period), value @ value.T
    stated, *left = (
        float((off_sine * products[np.ix_(order, order)]).sum()) + ROUNDING * np.trace(products)
        for order in ([*range(len(value))], *(_order(len(value), pair) for pair in pairs))
    )
    least = min(left)
    others = [rest for rest in left if rest > ALIKE * least]
    if least >= LEFT * stated or least >= CLEARLY * min(others, default=stated):
        return [], 1.0
    best = [pair for pair, rest in zip(pairs, left, strict=True) if rest <= ALIKE * least]
    return best, least / stated


def _off_sine(period: Period) -> Float[np.ndarray, "steps steps"]:
    """Return the matrix that projects grey levels onto the part that is no sine over the steps."""
    delta_rad = np.array(period.delta_rad)
    sine = np.stack([np.ones_like(delta_rad), np.cos(delta_rad), np.sin(delta_rad)], axis=-1)
    return np.eye(len(delta_rad)) - sine @ np.linalg.pinv(sine)


def _order(count: int, pair: Pair) -> list[int]:
    order = [*range(count)]
    order[pair[0]], order[pair[1]] = order[pair[1]], order[pair[0]]
    return order


def _exchanged(period: Period, pair: Pair) -> Period:
    order = _order(len(period.frames), pair)
    return replace(period, frames=tuple(period.frames[k] for k in order))


def _describe(
    axis: Axis,
    period: Period,
    pairs: Sequence[Pair],
    left: float,
    names: Sequence[str],
) -> str:
    first, *others = (" and ".join(names[period.frames[k]] for k in pair) for pair in pairs)
    unsure = "".join(f", or {other}" for other in others)
    if others:
        unsure += ", which these pictures cannot tell apart"
    return (
        f"the phase steps of period {period.period_px:g} px of the {axis}s are in a wrong order: "
        f"{first} may be exchanged{unsure}. The other order removes {100 * (1 - left):.1f} % of "
        "the grey levels' difference (squared) from a sine over the steps: check which picture is "
        "which step"
    )
