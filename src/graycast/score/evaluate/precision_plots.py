"""Precision over recall, and average precision by group, as sheets of plots."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from ...base.plotting import ACCENT, INK, SECOND, SOFT, caption, plain_figure, save_png
from .curves import RECALLS, precision_curves
from .judging import GroupRow, Judgement
from .matching import THRESHOLDS

_CURVES = ((0, INK), (5, ACCENT), (8, SECOND))  # Of THRESHOLDS, these are 0.50, 0.75, 0.90.
_CLASS_COLORS = (ACCENT, SECOND, "#4f9d69", "#7d5ba6", "#c8385a", "#8a7a2b")


def draw_precision_recall(
    judgements: Sequence[Judgement], categories: Mapping[int, str], path: Path
) -> None:
    """A panel for boxes, one for masks; beside each the classes, if there are several.

    Raises:
        GraycastError: the file cannot be written.
    """
    several = len(judgements[0].scores.matches) > 1
    panels = 2 if several else 1
    count = panels * len(judgements)
    figure, axes = plain_figure(4.6 * count, 4.0, (1,) * count)
    for judgement, at in zip(judgements, range(0, len(axes), panels), strict=True):
        curves = _curves(judgement)
        _thresholds(axes[at], judgement, curves)
        if several:
            _classes(axes[at + 1], judgement, curves, categories)
    save_png(figure, path, dpi=120)


def draw_groups(judgements: Sequence[Judgement], path: Path) -> None:
    """Average precision of each group, a panel for each way to group; no file if there is none.

    Raises:
        GraycastError: the file cannot be written.
    """
    ways = list(dict.fromkeys(row.by for row in judgements[0].rows if row.by != "all"))
    if not ways:
        return
    figure, axes = plain_figure(4.6 * len(ways), 3.8, (1,) * len(ways), grid="y")
    for ax, by in zip(axes, ways, strict=True):
        _bars(ax, by, judgements)
    save_png(figure, path, dpi=120)


def _curves(judgement: Judgement) -> dict[int, Float[np.ndarray, "t recalls"]]:
    """Of the classes that there are to find."""
    return {
        obj_id: precision_curves(one)
        for obj_id, one in judgement.scores.matches.items()
        if one.to_find.any()
    }


def _thresholds(
    ax: Axes, judgement: Judgement, curves: Mapping[int, Float[np.ndarray, "t recalls"]]
) -> None:
    if curves:
        mean = np.mean(list(curves.values()), axis=0)
        for t, color in _CURVES:
            label = f"{THRESHOLDS[t]:.2f}: {mean[t].mean():.3f}"
            ax.plot(RECALLS, mean[t], color=color, lw=1.5, label=label)
        _finish(ax, "overlap: AP")
    mean_of = "" if len(curves) < 2 else ", mean of the classes"
    caption(ax, f"{_plural(judgement)}{mean_of}", "recall", "precision")


def _classes(
    ax: Axes,
    judgement: Judgement,
    curves: Mapping[int, Float[np.ndarray, "t recalls"]],
    categories: Mapping[int, str],
) -> None:
    for i, (obj_id, curve) in enumerate(curves.items()):
        label = f"{categories.get(obj_id, obj_id)}: {curve[0].mean():.3f}"
        ax.plot(RECALLS, curve[0], color=_CLASS_COLORS[i % len(_CLASS_COLORS)], lw=1.3, label=label)
    if curves:
        _finish(ax, "class: AP50")
    caption(ax, f"{_plural(judgement)} at an overlap of 0.50", "recall", "precision")


def _plural(judgement: Judgement) -> str:
    return {"box": "Boxes", "mask": "Masks"}[judgement.kind]


def _finish(ax: Axes, title: str) -> None:
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1.02)
    ax.legend(fontsize=7, title=title, title_fontsize=7, frameon=False, loc="lower left")


def _bars(ax: Axes, by: str, judgements: Sequence[Judgement]) -> None:
    width = 0.8 / len(judgements)
    names: list[str] = []
    for k, judgement in enumerate(judgements):
        rows = [row for row in judgement.rows if row.by == by]
        names = [f"{row.name}\n({row.to_find})" for row in rows]
        at = np.arange(len(rows)) + (k - (len(judgements) - 1) / 2) * width
        color = (ACCENT, SECOND)[k]
        value = np.array([row.figures["ap"].value for row in rows])
        ax.bar(at, np.nan_to_num(value), width * 0.92, color=color, label=_plural(judgement))
        for x, row in zip(at, rows, strict=True):
            _whisker(ax, float(x), row)
    ax.set_xticks(range(len(names)), names, fontsize=7)
    ax.set_ylim(0, 1.02)
    ax.legend(fontsize=7, frameon=False)
    caption(ax, f"By {by}", "(instances to find)", "AP, 95 % interval")


def _whisker(ax: Axes, x: float, row: GroupRow) -> None:
    figure = row.figures["ap"]
    if np.isnan(figure.value):
        ax.text(x, 0.02, "none", fontsize=6, color=SOFT, ha="center")
    elif not np.isnan(figure.low):
        ax.plot([x, x], [figure.low, figure.high], color=INK, lw=1.1)
