"""Choose a setting: figures over all heaps, the Pareto front, and the recommendation."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float
from scipy import stats

from ..evaluate.intervals import LEVEL, Interval
from .point_fates import FATES, Fate
from .setting import Placed
from .study import DesignSpec

FEWEST_HEAPS = 4  # With fewer heaps, Student's t interval is wider than 4 standard errors.
FIGURES = ("of_seen", "sigma_m", "bias_m", "pixel_m", "feature_m", "seconds")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SettingFigures:
    """A setting's figures, which are means over the heaps, and the measured share of each heap.

    A figure is NaN if no heap has it. `front` is true for a setting on the Pareto front: no other
    setting is at least as good in measured share, sigma and seconds, and better in one of them.
    """

    name: str
    placed: Placed
    measured_by_heap: Float[np.ndarray, " heaps"]  # NaN where a heap could not be made
    figure: Mapping[str, float]
    share: Mapping[str, float]
    front: bool = False

    def __post_init__(self) -> None:
        self.measured_by_heap.flags.writeable = False

    @property
    def measured(self) -> Interval:
        return mean_interval(self.measured_by_heap)

    def missing(self) -> list[tuple[Fate, float]]:
        """Return the fates of the unmeasured surface with their shares, largest first."""
        lost = [(fate, self.share[fate]) for fate in FATES if fate is not Fate.MEASURED]
        return sorted((pair for pair in lost if pair[1] > 0), key=lambda pair: -pair[1])


def mean_interval(value: Float[np.ndarray, " n"]) -> Interval:
    """Return a mean with its 95 % interval by Student's t distribution; NaN values are ignored."""
    value = value[np.isfinite(value)]
    if not len(value):
        return Interval(value=math.nan, low=math.nan, high=math.nan)
    mean = float(value.mean())
    if len(value) < 2:
        return Interval(value=mean, low=math.nan, high=math.nan)
    t = float(stats.t.ppf((1 + LEVEL) / 2, len(value) - 1))
    half = t * float(value.std(ddof=1)) / math.sqrt(len(value))
    return Interval(value=mean, low=mean - half, high=mean + half)


def row_of(placed: Placed, heaps: Sequence[Mapping[str, Any] | None]) -> SettingFigures:
    """Return a setting's figures from its figures for each heap; a heap without figures is None."""
    finished = [heap for heap in heaps if heap is not None]
    return SettingFigures(
        name=placed.setting.name,
        placed=placed,
        measured_by_heap=np.array(
            [math.nan if heap is None else heap["measured"] for heap in heaps], dtype=np.float64
        ),
        figure={name: _mean([heap[name] for heap in finished]) for name in FIGURES},
        share={fate: _mean([heap["share"][fate] for heap in finished]) for fate in FATES},
    )


def _mean(values: Sequence[float | None]) -> float:
    numbers = [value for value in values if value is not None]
    return float(np.mean(numbers)) if numbers else math.nan


def on_front(values: Float[np.ndarray, "n figures"]) -> list[bool]:
    """Return whether each row is on the Pareto front; smaller figures are better.

    A row is off the front if it contains a NaN, or if another row is nowhere worse and at least
    once better.
    """
    beaten = np.isnan(values).any(axis=1)
    for i, own in enumerate(values):
        no_worse = (values <= own).all(axis=1) & (values < own).any(axis=1)
        beaten[i] |= bool(no_worse.any())
    return [not each for each in beaten]


def cost(row: SettingFigures) -> tuple[float, float, float]:
    """Return the quantities to minimise, rounded: unmeasured share, sigma [mm], seconds."""
    sigma_mm, seconds = 1e3 * row.figure["sigma_m"], row.figure["seconds"]
    return round(1 - row.measured.value, 3), round(sigma_mm, 2), round(seconds, 2)


def choose(spec: DesignSpec, rows: Sequence[SettingFigures]) -> SettingFigures | None:
    """Return the setting with the largest measured share among those that meet the needs."""
    fit = [row for row in rows if meets(spec, row) and math.isfinite(row.measured.value)]
    return max(fit, key=lambda row: row.measured.value, default=None)


def meets(spec: DesignSpec, row: SettingFigures) -> bool:
    wanted = spec.needs.model_dump(exclude_none=True)
    return all(row.figure[name] <= most for name, most in wanted.items())


def unlike(rows: Sequence[SettingFigures], best: SettingFigures) -> Mapping[str, Interval]:
    """Return the best row's measured share minus that of each other row, with intervals."""
    return {
        row.name: mean_interval(best.measured_by_heap - row.measured_by_heap)
        for row in rows
        if row is not best
    }


def sentences(spec: DesignSpec, rows: Sequence[SettingFigures]) -> str:
    """Return the recommendation as text."""
    best = choose(spec, rows)
    if best is None:
        return (
            f"None of the {len(rows)} settings {_wanted(spec)}. {_nearest(spec, rows)}{_few(spec)}"
        )
    paragraph = (
        f"{where(best)} measures {_percent(best.measured)} of the open surface of the parts, with "
        f"a sigma of {1e3 * best.figure['sigma_m']:.2f} mm and a bias of "
        f"{1e3 * best.figure['bias_m']:+.2f} mm. It resolves features from "
        f"{1e3 * best.figure['feature_m']:.1f} mm and takes {best.figure['seconds']:.2f} s a scan."
    )
    lost = [f"{share:.1%} {_WORDS[fate]}" for fate, share in best.missing()[:3]]
    if lost:
        paragraph += f" Most of what it misses is {_list(lost)}."
    paragraph += f" Of the {len(rows)} settings it measures most"
    paragraph += f" among those of which each {_wanted(spec)}." if _needs(spec) else "."
    fit = [row for row in rows if meets(spec, row) and row is not best]
    like = [name for name, less in unlike(fit, best).items() if not less.low > 0]
    if like and spec.layouts > 1:
        paragraph += (
            f" On these {spec.layouts} heaps its difference is not significant from {_list(like)}."
        )
    return paragraph + _few(spec)


def _few(spec: DesignSpec) -> str:
    """Return a warning if there are too few heaps to distinguish the settings."""
    if spec.layouts >= FEWEST_HEAPS:
        return ""
    heaps = "One heap gives no interval" if spec.layouts == 1 else f"{spec.layouts} heaps are few"
    return f" Warning: {heaps}. Give at least {FEWEST_HEAPS} as layouts before you decide."


def where(row: SettingFigures) -> str:
    """Return a setting in words: rig, pose, code, exposure, bin and resolution."""
    setting, cell = row.placed.setting, row.placed.cell
    view, rig = cell.config.view, cell.scene.rig
    words = f"The rig {rig.name}"
    if setting.baseline_m is not None:
        words += f" with a baseline of {setting.baseline_m:g} m"
    if view.distance_m is not None:
        words += f" at {view.distance_m:g} m"
    words += f" tilted {view.tilt_deg:g} degrees" if view.tilt_deg else " looking straight down"
    if view.azimuth_deg:
        words += f", turned {view.azimuth_deg:g} degrees about the vertical,"
    names = {
        "the code": setting.code,
        "the exposure": setting.exposure,
        "the bin": setting.bin,
        "the resolution": setting.resolution,
    }
    named = [f"{key} {value}" for key, value in names.items() if value is not None]
    return f"{words} with {_list(named)}" if named else words


_WORDS = {
    Fate.OUTSIDE_PICTURE: "outside the picture",
    Fate.HIDDEN_BY_WALL: "hidden from the camera by the bin",
    Fate.HIDDEN_BY_PARTS: "hidden from the camera by parts",
    Fate.OUTSIDE_PROJECTOR: "beyond the projector's picture",
    Fate.WALL_SHADOW: "in the bin's shadow",
    Fate.PART_SHADOW: "in the shadow of parts",
    Fate.EDGE: "at edges finer than the pixels",
    Fate.DARK: "too dark",
    Fate.GLARE: "glaring",
    Fate.INTERREFLECTION: "lost to interreflections",
    Fate.FILTERED: "taken out by filters",
    Fate.OUT_OF_RANGE: "out of the rig's range",
    Fate.WRONG: "measured wrongly",
}
_UNIT = {"sigma_m": ("sigma", "mm", 1e3), "feature_m": ("feature", "mm", 1e3)}
_UNIT |= {"seconds": ("scan time", "s", 1.0)}


def _needs(spec: DesignSpec) -> list[str]:
    needs = []
    for name, most in spec.needs.model_dump(exclude_none=True).items():
        words, unit, factor = _UNIT[name]
        needs.append(f"a {words} of at most {factor * most:g} {unit}")
    return needs


def _wanted(spec: DesignSpec) -> str:
    return f"has {_list(_needs(spec))}"


def _nearest(spec: DesignSpec, rows: Sequence[SettingFigures]) -> str:
    """Return the smallest value of each limited quantity over all settings, as text."""
    least = []
    for name in spec.needs.model_dump(exclude_none=True):
        candidates = [row for row in rows if math.isfinite(row.figure[name])]
        if candidates:
            row = min(candidates, key=lambda row: row.figure[name])
            words, unit, factor = _UNIT[name]
            least.append(
                f"The least {words} is {factor * row.figure[name]:.3g} {unit}, of {row.name}."
            )
    return " ".join(least) or "Nothing was measured at all."


def _percent(interval: Interval) -> str:
    text = f"{interval.value:.1%}"
    if math.isnan(interval.low):
        return text
    return f"{text} (95 % interval {max(interval.low, 0):.1%} to {min(interval.high, 1):.1%})"


def _list(words: Sequence[str]) -> str:
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else "".join(words)
