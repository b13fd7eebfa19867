"""Plots for docs/measurements/renderers.md from the results of agree, denoise and renderers."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, Locator, LogLocator, NullFormatter

from graycast.base.plotting import ACCENT, INK, PALE, SECOND, SOFT, caption, plain_figure, save_png

from .agree import MEDIAN_COLUMNS, MEDIAN_RATIO
from .figures import Figures

COLOR = {"mitsuba": ACCENT, "cycles": SECOND, "cycles3": "#e0a458"}
STYLE = {"none": "o-", "oidn": "s--", "optix": "^:"}
CLASS_COLOR = {"diffuse": ACCENT, "metal": INK, "plastic": SECOND, "bin": "#b08d57"}

SUBS = (1, 2, 5)  # minor ticks in a decade of a logarithmic axis


def draw(figures: Figures, path: Path) -> None:
    """Write the plots of a benchmark as one PNG.

    Raises:
        GraycastError: the file cannot be written.
    """
    plots = {"agree": _agreement, "denoise": _denoisers, "renderers": _renderers}
    save_png(plots[figures["benchmark"]](figures), path, dpi=110)


def _agreement(figures: Figures) -> Figure:
    figure, (white, ambient, depth) = plain_figure(12.0, 3.6, (1, 1, 1))
    histograms = figures["histograms"]
    edges = np.array(histograms["ratio_edges"])
    for ax, light in ((white, "white"), (ambient, "ambient")):
        for name, color in CLASS_COLOR.items():
            counts = np.array(histograms.get(f"{light} {name}", ()), dtype=float)
            if counts.sum():
                ax.stairs(counts / counts.max(), edges, color=color, lw=1.4, label=name)
        ax.axvline(1, color=SOFT, lw=0.8)
        ax.legend(fontsize=8, frameon=False)
        title = {"white": "Projector's light", "ambient": "All other light"}[light]
        caption(ax, title, f"{figures['second']} / {figures['first']}, pixels", "of the most")
    low, high = MEDIAN_RATIO["diffuse"]
    white.axvspan(low, high, color=PALE, zorder=0)
    counts = np.array(histograms["columns"], dtype=float)
    depth.stairs(counts / max(counts.max(), 1), histograms["column_edges"], color=INK, lw=1.4)
    depth.axvspan(-MEDIAN_COLUMNS, MEDIAN_COLUMNS, color=PALE, zorder=0)
    depth.set_yscale("log")
    difference = f"{figures['second']} less {figures['first']}"
    caption(depth, "Decoded place", f"{difference} [projector columns]", "of the most")
    return figure


def _denoisers(figures: Figures) -> Figure:
    figure, axes = plain_figure(9.6, 6.4, (1, 1), rows=2)
    rows = figures["rows"]
    panels = (
        ("samples", "bad_share", "Wrong, lost or extra pixels", "samples", "share"),
        ("samples", "depth_rms_right_mm", "Depth of right pixels", "samples", "RMS [mm]"),
        ("seconds", "bad_share", "What a second buys", "seconds per stack", "share"),
    )
    for ax, (x, y, title, below, beside) in zip(axes, panels, strict=False):
        _curves(ax, rows, x, y)
        caption(ax, title, below, beside)
    _curves(axes[3], rows, "samples", "edge_growth_px", log=False)
    axes[3].axhline(0, color=INK, lw=0.8)
    caption(axes[3], "How far lit stripes grow at an edge", "samples", "camera px")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8, frameon=False
    )
    return figure


def _renderers(figures: Figures) -> Figure:
    figure, (seconds, wrong, depth) = plain_figure(12.0, 3.6, (1, 1, 1))
    names = {"onepass": "Mitsuba, one pass", "cycles3": "Cycles, 3 a render", "cycles": "Cycles"}
    colors = (COLOR["mitsuba"], COLOR["cycles3"], COLOR["cycles"])
    values = [figures[f"{name}_s"] for name in names]
    bars = seconds.barh(list(names.values()), values, color=colors, height=0.55)
    labels = [f"{value:.3g} s" for value in values]
    seconds.bar_label(bars, labels, fontsize=8, padding=3, color=INK)
    seconds.set_xscale("log")
    seconds.set_xlim(min(values) / 3, max(values) * 6)
    seconds.invert_yaxis()
    seconds.grid(axis="y", visible=False)
    size = f"{figures['width_px']} x {figures['height_px']}, {figures['samples']} samples"
    caption(seconds, f"{figures['patterns']} patterns, {size}", "seconds", "")
    for ax, measure, title, unit in (
        (wrong, "bad_share", "Wrong, lost or extra pixels", "share"),
        (depth, "depth_rms_right_mm", "Depth of right pixels", "RMS [mm]"),
    ):
        _curves(ax, figures["errors"], "samples", measure)
        row = next(row for row in figures["equal_error"] if row["measure"] == measure)
        if row["error"] > 0:
            ax.axhline(row["error"], color=SOFT, lw=0.8)
        caption(ax, title, "samples", unit)
        ax.legend(fontsize=8, frameon=False)
    return figure


def _curves(ax: Axes, rows: list[Figures], x: str, y: str, *, log: bool = True) -> None:
    kinds = dict.fromkeys((row["renderer"], row["denoise"]) for row in rows)
    for renderer, denoise in kinds:
        own = [row for row in rows if (row["renderer"], row["denoise"]) == (renderer, denoise)]
        style: dict[str, Any] = {"color": COLOR.get(renderer, INK), "ms": 4, "lw": 1.3}
        label = renderer if denoise == "none" else f"{renderer}, {denoise}"
        places = [row.get(y, np.nan) for row in own]
        ax.plot([row[x] for row in own], places, STYLE[denoise], label=label, **style)
    ax.set_xscale("log")
    counts = sorted({row[x] for row in rows})
    _number(ax.xaxis, FixedLocator(counts) if x == "samples" else LogLocator(subs=SUBS))
    if log:
        ax.set_yscale("log")
        _number(ax.yaxis, LogLocator(subs=SUBS))


def _number(axis: Axis, locator: Locator) -> None:
    """Label only the major ticks of a logarithmic axis, with plain numbers."""
    axis.set_major_locator(locator)
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
