"""Times of Mitsuba, and of Cycles with one or three patterns per render.

The results are in docs/measurements/renderers.md. The renderers run in turn on one scene, from
scene to radiance and ground truth. Cycles renders only a few patterns and the fixed frames (white,
ambient, quantities); the time of the other patterns is estimated from the median frame. Processes
and kernels are loaded before. At a smaller size, a second study finds the number of samples with
which both renderers have the same error of decoded depth against their own converged pictures.
"""

import math
import time
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import mean, median
from typing import Any

import numpy as np
from jaxtyping import UInt8

from graycast.cell.resolve import Cell
from graycast.rendering import Quality, Renderer
from graycast.rendering.cycles.job import need_renders
from graycast.world.scene import Layout

from .cells import PHASE, PHASE_BOTH, bracket_cell, dropped, opened
from .convergence import converge, error_row, samples_for
from .denoise import REFERENCE_FACTOR, sample_counts
from .figures import Figures, Show
from .processes import children_peak_rss_bytes, cpu_s
from .stages import PARTS

SIZE_PX = (1032, 772)
TIMED = {1: 3, 3: 2}  # number of timed renders, by patterns per render
ROUNDS = 2
FEW_SAMPLES = 4  # second point for the linear fit of frame time over samples
ERROR_SIZE_PX = (172, 130)
ERROR_MOST = 128
MEASURES = ("bad_share", "depth_rms_right_mm")


@dataclass(slots=True)
class Stopwatch:
    """Wall and processor time since the start, recorded after each frame of Cycles."""

    start_s: float = field(default_factory=lambda: time.perf_counter())
    start_cpu_s: float = field(default_factory=lambda: cpu_s())
    marks: list[tuple[float, float]] = field(default_factory=list)

    def mark(self) -> None:
        self.marks.append((time.perf_counter() - self.start_s, cpu_s() - self.start_cpu_s))

    def steady(self, count: int) -> tuple[float, float]:
        """Return the median wall and processor seconds of frames 1 to `count` - 1."""
        pairs = list(pairwise(self.marks[:count]))
        wall_s = median(after[0] - before[0] for before, after in pairs)
        return wall_s, median(after[1] - before[1] for before, after in pairs)


def measure(*, samples: int, show: Show) -> Figures:
    with opened(1, 3) as all_three:
        return study(*all_three, count=PARTS, samples=samples, size_px=SIZE_PX, show=show)


def study(
    mitsuba: Renderer,
    cycles: Renderer,
    three: Renderer,
    *,
    count: int,
    samples: int,
    size_px: tuple[int, int],
    show: Show,
) -> Figures:
    """Time a stack with each renderer; return seconds, and ratios at equal samples and equal error.

    Args:
        three: Cycles with three patterns per render.
        count: number of brackets in the box.

    Raises:
        ValueError: there are too few samples, or the size exceeds the camera's picture.
    """
    if samples <= FEW_SAMPLES:
        raise ValueError(f"samples is {samples}; give more than {FEW_SAMPLES}, which is also timed")
    cell = bracket_cell(count, PHASE_BOTH, size_px)
    layout = dropped(cell, count, seed=0)
    all_three = (mitsuba, cycles, three)
    small = bracket_cell(count, PHASE, ERROR_SIZE_PX)
    timed = _timed(cell, layout, all_three, samples, show)
    rows = _errors(small, layout, all_three, show)
    return {
        "devices": {one.name: one.device for one in (mitsuba, cycles)},
        "parts": count,
        "width_px": size_px[0],
        "height_px": size_px[1],
        "patterns": len(cell.code.frames),
        "samples": samples,
        **timed,
        "error_size_px": list(ERROR_SIZE_PX),
        "errors": rows,
        "equal_error": equal_error(rows, timed, samples),
        "cycles_peak_rss_bytes": children_peak_rss_bytes(),
    }


# --- time ----------------------------------------------------------------------------------------


def _timed(
    cell: Cell,
    layout: Layout,
    renderers: tuple[Renderer, Renderer, Renderer],
    samples: int,
    show: Show,
) -> Figures:
    mitsuba, cycles, _ = renderers
    patterns = cell.patterns()
    for renderer in renderers:
        show(f"warming up {renderer.name}")
        warm_up = patterns if renderer is mitsuba else patterns[need_renders(patterns)[:1]]
        quality = Quality(samples=samples if renderer is mitsuba else 1)
        renderer.render(cell.scene, layout, warm_up, quality=quality, seed=0)
    stacks: dict[str, list[Figures]] = {"onepass": [], "cycles": [], "cycles3": []}
    for _ in range(ROUNDS):
        for (name, ends), renderer in zip(stacks.items(), renderers, strict=True):
            show(f"timing {name}")
            ends.append(_stack(cell, layout, renderer, patterns, Quality(samples=samples)))
    figures: Figures = {}
    for name, ends in stacks.items():
        figures |= {f"{name}_{key}": mean(end[key] for end in ends) for key in ends[0]}
    for name in ("cycles", "cycles3"):
        figures[f"{name}_over_onepass"] = figures[f"{name}_s"] / figures["onepass_s"]
        figures[f"{name}_over_onepass_cpu"] = figures[f"{name}_cpu_s"] / figures["onepass_cpu_s"]
    show(f"timing cycles at {FEW_SAMPLES} samples")
    few = _stack(cell, layout, cycles, patterns, Quality(samples=FEW_SAMPLES))
    figures["cycles_frame_cpu_s_at_few_samples"] = few["frame_cpu_s"]
    rounds = zip(*stacks.values(), strict=True)
    figures["rounds"] = [
        {name: end["s"] for name, end in zip(stacks, ends, strict=True)} for ends in rounds
    ]
    return figures


def _stack(
    cell: Cell,
    layout: Layout,
    renderer: Renderer,
    patterns: UInt8[np.ndarray, "n ph pw"],
    quality: Quality,
) -> Figures:
    """Return wall and processor seconds of a stack; for Cycles, an estimate from a few renders."""
    watch = Stopwatch()
    if renderer.name != "cycles":
        renderer.render(cell.scene, layout, patterns, quality=quality, seed=1)
        watch.mark()
        return {"s": watch.marks[-1][0], "cpu_s": watch.marks[-1][1]}
    cycles: Any = renderer
    patterns, each = patterns[need_renders(patterns)], cycles.patterns_per_render
    count = math.ceil(len(patterns) / each)
    timed = min(TIMED[each], count)
    cycles.on_frame = lambda done, total: watch.mark()
    renderer.render(cell.scene, layout, patterns[: timed * each], quality=quality, seed=1)
    watch.mark()
    frame_s, frame_cpu_s = watch.steady(timed)
    total_s, total_cpu_s = watch.marks[-1]
    return {
        "s": total_s + (count - timed) * frame_s,
        "cpu_s": total_cpu_s + (count - timed) * frame_cpu_s,
        "frame_s": frame_s,
        "frame_cpu_s": frame_cpu_s,
        "renders": count,
        "renders_timed": timed,
    }


# --- error ---------------------------------------------------------------------------------------


def equal_error(rows: list[Figures], timed: Figures, samples: int) -> list[Figures]:
    """Return, for each error measure, the numbers of samples at which both have the same error.

    `cycles_samples` are needed for the error of Mitsuba's one pass at `samples`, and
    `onepass_samples_for_cycles_error` the reverse. `cycles_over_onepass_cpu` is the ratio of
    processor times at equal error. It assumes that processor time is linear in the samples; wall
    time is not, because short frames leave processors idle. A '>' or '<' means that the number is
    outside the tried range.
    """
    frame_s, few_s = timed["cycles_frame_cpu_s"], timed["cycles_frame_cpu_s_at_few_samples"]
    slope_s = (frame_s - few_s) / (samples - FEW_SAMPLES)
    result = []
    for measure in MEASURES:
        own = {
            name: [row for row in rows if row["renderer"] == name] for name in ("mitsuba", "cycles")
        }
        target = _at(own["mitsuba"], measure, samples)
        needed, side = samples_for(own["cycles"], measure, target)
        fewer, other_side = samples_for(
            own["mitsuba"], measure, _at(own["cycles"], measure, samples)
        )
        grown = 1 + slope_s * (needed - samples) / frame_s
        result.append(
            {
                "measure": measure,
                "onepass_samples": samples,
                "error": target,
                "cycles_samples": needed,
                "cycles_side": side,
                "cycles_over_onepass_cpu": timed["cycles_over_onepass_cpu"] * grown,
                "cycles3_over_onepass_cpu": timed["cycles3_over_onepass_cpu"] * grown,
                "onepass_samples_for_cycles_error": fewer,
                "onepass_side": other_side,
            }
        )
    return result


def _at(rows: list[Figures], measure: str, samples: int) -> float:
    return min(rows, key=lambda row: abs(row["samples"] - samples))[measure]


def _errors(
    cell: Cell, layout: Layout, renderers: tuple[Renderer, Renderer, Renderer], show: Show
) -> list[Figures]:
    """Measure the error of decoded depth over samples, for Mitsuba's one pass and for Cycles."""
    mitsuba, cycles, three = renderers
    rows = []
    for renderer, for_reference in ((mitsuba, mitsuba), (cycles, three)):
        reference = converge(cell, layout, for_reference, REFERENCE_FACTOR * ERROR_MOST, show)
        for samples in sample_counts(ERROR_MOST):
            rows.append(error_row(reference, renderer, samples, "none", show)[0])
    return rows
