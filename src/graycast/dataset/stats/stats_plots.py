"""Draw a dataset's statistics as one sheet of plots."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ...base.plotting import ACCENT, SECOND, SOFT, caption, plain_figure, save_png
from ...camera.decode import REASON_COLOR
from .gather import SIDE_EDGES_PX, VISIBILITY_BINS, Statistics
from .scene_statistics import DEPTH_BIN_MM

_CLASS_COLORS = (ACCENT, SECOND, "#4f9d69", "#7d5ba6", "#c8385a", "#8a7a2b")
_ERROR_SIGMAS = 5.0
_ERROR_BARS = 100  # With more bars, the plot would show noise.


def draw_statistics(statistics: Statistics, path: Path) -> None:
    """Write the sheet as a PNG file.

    Raises:
        GraycastError: the file cannot be written.
    """
    figure, axes = plain_figure(13.2, 5.6, (1, 1, 1, 1), rows=2, grid="y")
    drawings = (_counts, _visibility, _sides, _depth, _reasons, _errors, _decoded, _brightness)
    for ax, draw in zip(axes, drawings, strict=True):
        draw(ax, statistics)
    save_png(figure, path, dpi=120)


def _counts(ax: Axes, s: Statistics) -> None:
    ax.bar(list(s.instances), list(s.instances.values()), width=0.9, color=ACCENT)
    ax.set_xlim(min(s.instances) - 3, max(s.instances) + 3)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    total = sum(one.instances for one in s.classes)
    caption(ax, f"Instances per scene ({total:,} in all)", "instances", "scenes")


def _stacked(ax: Axes, edges: np.ndarray, counts: list[np.ndarray], names: list[str]) -> None:
    base = np.zeros(len(edges) - 1)
    for k, (count, name) in enumerate(zip(counts, names, strict=True)):
        width, color = np.diff(edges), _CLASS_COLORS[k % len(_CLASS_COLORS)]
        ax.bar(edges[:-1], count, width, bottom=base, align="edge", color=color, label=name)
        base = base + count
    if 1 < len(names) <= 6:
        ax.legend(fontsize=7, frameon=False)


def _visibility(ax: Axes, s: Statistics) -> None:
    edges = np.linspace(0, 1, VISIBILITY_BINS + 1)
    _stacked(ax, edges, [one.visib_fract for one in s.classes], [one.name for one in s.classes])
    caption(ax, "Visibility", "visible share of the silhouette", "instances")


def _sides(ax: Axes, s: Statistics) -> None:
    counts = [one.side_px for one in s.classes]
    _stacked(ax, SIDE_EDGES_PX, counts, [one.name for one in s.classes])
    ax.set_xscale("log", base=2)
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    used = np.flatnonzero(sum(counts, np.zeros(len(SIDE_EDGES_PX) - 1)))
    if len(used):
        ax.set_xlim(SIDE_EDGES_PX[used[0]], SIDE_EDGES_PX[used[-1] + 1])
    caption(ax, "Mask size", "root of the visible area [px]", "instances")


def _depth(ax: Axes, s: Statistics) -> None:
    at = (np.array(list(s.depth_bin), dtype=float) + 0.5) * DEPTH_BIN_MM
    share = np.array(list(s.depth_bin.values()), dtype=float) / max(s.pixels, 1)
    ax.bar(at, 100 * share, width=DEPTH_BIN_MM, color=ACCENT)
    if s.depth_bin:
        quantiles = s.depth_quantiles_mm
        ax.set_xlim(quantiles["p01"] - 3 * DEPTH_BIN_MM, quantiles["p99"] + 3 * DEPTH_BIN_MM)
    caption(ax, "Perfect depth", "z [mm]", "pixels [%]")


def _reasons(ax: Axes, s: Statistics) -> None:
    for row, shares in enumerate((s.reason, s.part_reason)):
        left = 0.0
        for name, share in shares.items():
            color = REASON_COLOR.get(name, SOFT)
            label = name.replace("_", " ") if not row and share >= 5e-4 else None
            ax.barh(row, 100 * share, left=left, color=color, height=0.5, label=label)
            left += 100 * share
    ax.set_yticks([0, 1], ["all", "parts"])
    ax.set_ylim(-0.5, 3.2)
    ax.legend(fontsize=6.5, frameon=False, ncols=2, loc="upper left")
    caption(ax, "Why there is no depth", "pixels [%]")


def _errors(ax: Axes, s: Statistics) -> None:
    caption(ax, "Scanner less perfect depth", "[mm]", "pixels [%]")
    if not s.error.pixels:
        return
    reach = max(_ERROR_SIGMAS * s.error.sigma_mm, 3 * s.depth_scale_mm)
    # A bar covers whole steps; the middle bar is centred on zero.
    width_mm = max(1, round(2 * reach / s.depth_scale_mm / _ERROR_BARS)) * s.depth_scale_mm
    half = int(reach / width_mm) + 1
    edges_mm = (np.arange(-half, half + 2) - 0.5) * width_mm
    for counts, color, name in (
        (s.error_step, SOFT, "all"),
        (s.part_error_step, ACCENT, "parts"),
    ):
        step = np.array(list(counts), dtype=float)
        weight = np.array(list(counts.values()), dtype=float)
        if len(step):
            share = 100 * weight / weight.sum()
            height, _ = np.histogram(step * s.depth_scale_mm, edges_mm, weights=share)
            ax.stairs(height, edges_mm, color=color, lw=1.2, label=name)
    ax.set_xlim(-reach, reach)
    ax.legend(fontsize=7, frameon=False)


def _decoded(ax: Axes, s: Statistics) -> None:
    edges = np.linspace(0, 100, len(s.decoded_share) + 1)
    ax.bar(edges[:-1], s.decoded_share, np.diff(edges), align="edge", color=ACCENT)
    caption(ax, "Decoded share of parts", "decoded pixels of the parts [%]", "scenes")


def _brightness(ax: Axes, s: Statistics) -> None:
    for counts, color, name in ((s.gray, ACCENT, "white frame"), (s.luma, SECOND, "colour")):
        if counts:
            level = np.bincount(list(counts), list(counts.values()), minlength=256)
            share = 100 * level.reshape(64, 4).sum(axis=1) / level.sum()
            ax.step(np.arange(64) * 4 + 2, share, where="mid", color=color, lw=1.2, label=name)
    ax.legend(fontsize=7, frameon=False)
    caption(ax, "Brightness", "value of 255", "pixels [%]")
