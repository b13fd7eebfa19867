"""Plots of a judgement, and sheets of its worst mistakes: crops with true and detected outlines."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from pycocotools import mask as coco_mask

from ...base.plotting import (
    ACCENT,
    INK,
    SECOND,
    SOFT,
    caption,
    legend_below,
    plain_figure,
    save_png,
)
from .judging import GroupRow, Judgement
from .matching import THRESHOLDS
from .mistakes import NEAR, FalseAlarm, Miss
from .scores import RECALLS, precision_curves

MOST_CROPS = 20
TRUTH_COLOR, DETECTION_COLOR = "#3ddc84", "#ff4d4d"
_COLUMNS = 5
_MARGIN = 0.6  # margin on each side of a crop, as a share of the box's longer side
_LEAST_PX = 48

Picture = Callable[[int], UInt8[np.ndarray, "h w 3"]]
_CURVES = ((0, INK), (5, ACCENT), (8, SECOND))  # indices of 0.50, 0.75 and 0.90 in THRESHOLDS
_CLASS_COLORS = (ACCENT, SECOND, "#4f9d69", "#7d5ba6", "#c8385a", "#8a7a2b")


def draw_precision_recall(
    judgements: Sequence[Judgement], categories: Mapping[int, str], path: Path
) -> None:
    """Plot precision-recall curves for boxes and masks, as class means and for each class."""
    several = len(judgements[0].scores.matches) > 1
    panels = 2 if several else 1
    count = panels * len(judgements)
    figure, axes = plain_figure(4.6 * count, 4.5, (1,) * count)
    for judgement, at in zip(judgements, range(0, len(axes), panels), strict=True):
        curves = _curves(judgement)
        _thresholds(axes[at], judgement, curves)
        if several:
            _classes(axes[at + 1], judgement, curves, categories)
    save_png(figure, path, dpi=120)


def draw_groups(judgements: Sequence[Judgement], path: Path) -> None:
    """Plot the average precision of each group; write no file if there are no groups."""
    ways = list(dict.fromkeys(row.by for row in judgements[0].rows if row.by != "all"))
    if not ways:
        return
    figure, axes = plain_figure(4.6 * len(ways), 3.8, (1,) * len(ways), grid="y")
    for ax, by in zip(axes, ways, strict=True):
        _bars(ax, by, judgements)
    save_png(figure, path, dpi=120)


def _curves(judgement: Judgement) -> dict[int, Float[np.ndarray, "t recalls"]]:
    """Return the precision curves of the classes that have instances to find."""
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
    legend_below(ax, columns=3, title=title)


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
    ax.legend(fontsize=7, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    caption(ax, f"By {by.replace('_', ' ')}", "(instances to find)", "AP, 95 % interval")


def _whisker(ax: Axes, x: float, row: GroupRow) -> None:
    figure = row.figures["ap"]
    if np.isnan(figure.value):
        ax.text(x, 0.02, "none", fontsize=6, color=SOFT, ha="center")
    elif not np.isnan(figure.low):
        ax.plot([x, x], [figure.low, figure.high], color=INK, lw=1.1)


# --- mistakes -----------------------------------------------------------------------------------


def draw_misses(judgement: Judgement, picture: Picture, path: Path) -> None:
    """Draw the most visible missed instances; write no file if no instance was missed."""
    least = judgement.point.score
    threshold = "" if np.isnan(least) else f"; red: what was found from a score of {least:.2f} on"
    crops = []
    for miss in judgement.misses[:MOST_CROPS]:
        labels = judgement.known.labels[miss.scene]
        known = "" if labels.visib_fract is None else f", {labels.visib_fract[miss.instance]:.0%}"
        head = f"scene {labels.scene_id}{known}{' visible' if known else ''}"
        crops.append((miss, f"{head}\n{_nearest(miss)}"))
    heading = f"{len(judgement.misses)} missed (green){threshold}"
    _draw_sheet(judgement, crops, heading, picture, path)


def draw_false_alarms(judgement: Judgement, picture: Picture, path: Path) -> None:
    """Draw the false alarms with the highest scores; write no file if there are no false alarms."""
    crops = []
    for alarm in judgement.false_alarms[:MOST_CROPS]:
        head = f"scene {judgement.known.labels[alarm.scene].scene_id}, score {alarm.score:.2f}"
        crops.append((alarm, f"{head}\n{alarm.why}, overlap {alarm.overlap:.2f}"))
    heading = f"{len(judgement.false_alarms)} false alarms (red); green: what is there"
    _draw_sheet(judgement, crops, heading, picture, path)


def _nearest(miss: Miss) -> str:
    if miss.overlap < NEAR:
        return "nothing was found near it"
    return f"nearest: overlap {miss.overlap:.2f}, score {miss.score:.2f}"


def _draw_sheet(
    judgement: Judgement,
    crops: Sequence[tuple[Miss | FalseAlarm, str]],
    heading: str,
    picture: Picture,
    path: Path,
) -> None:
    """Write one sheet with crops of the mistakes and their titles."""
    if not crops:
        return
    rows = -(-len(crops) // _COLUMNS)
    figure = Figure(figsize=(2.3 * _COLUMNS, 2.6 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, squeeze=False).ravel().tolist()
    for ax in axes:
        ax.set_axis_off()
    figure.suptitle(heading, fontsize=9, color=INK, x=0.01, ha="left")
    for ax, (mistake, title) in zip(axes, crops, strict=False):
        _draw(ax, judgement, mistake, picture, title)
    save_png(figure, path, dpi=90)


def _draw(
    ax: Axes, judgement: Judgement, mistake: Miss | FalseAlarm, picture: Picture, title: str
) -> None:
    known = judgement.known
    labels, detections = known.labels[mistake.scene], known.detections[mistake.scene]
    image = picture(labels.scene_id)
    if isinstance(mistake, Miss):
        center = labels.box_px[mistake.instance]
    else:
        center = detections.box_px[mistake.detection]
    left, top, right, bottom = _window(center.astype(float), image.shape[:2])
    ax.imshow(image[top:bottom, left:right], extent=(left, right, bottom, top))
    least = judgement.point.score
    above = np.flatnonzero(~(detections.score < least)) if not np.isnan(least) else np.arange(0)
    for i in above.tolist():
        own = isinstance(mistake, FalseAlarm) and i == mistake.detection
        if own or isinstance(mistake, Miss):
            _outline(
                ax,
                detections.box_px[i],
                _mask_of(detections.mask, i, judgement),
                DETECTION_COLOR,
                own,
            )
    for i in range(len(labels)):
        own = isinstance(mistake, Miss) and i == mistake.instance
        if own or isinstance(mistake, FalseAlarm):
            _outline(ax, labels.box_px[i], _mask_of(labels.mask, i, judgement), TRUTH_COLOR, own)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    ax.set_title(title, fontsize=7, color=INK)


def _mask_of(
    masks: tuple[Mapping[str, Any], ...] | None, i: int, judgement: Judgement
) -> Mapping[str, Any] | None:
    return masks[i] if judgement.kind == "mask" and masks is not None else None


def _window(box: Float[np.ndarray, "4"], size_px: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Return the borders of a square around a box, clipped to the picture."""
    side = max(box[2], box[3]) * (1 + 2 * _MARGIN)
    half = max(side, _LEAST_PX) / 2
    x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
    height_px, width_px = size_px
    left, top = int(max(x - half, 0)), int(max(y - half, 0))
    left, top = min(left, width_px - 1), min(top, height_px - 1)
    right, bottom = int(min(x + half, width_px)), int(min(y + half, height_px))
    return left, top, max(right, left + 1), max(bottom, top + 1)


def _outline(
    ax: Axes,
    box: Float[np.ndarray, "4"],
    mask: Mapping[str, Any] | None,
    color: str,
    own: bool,
) -> None:
    width = 1.8 if own else 0.9
    if mask is None:
        ax.add_patch(
            Rectangle(
                (box[0], box[1]), box[2], box[3], fill=False, edgecolor=color, linewidth=width
            )
        )
        return
    inside: Bool[np.ndarray, "h w"] = coco_mask.decode(dict(mask)).astype(bool)
    if inside.any():
        height_px, width_px = inside.shape
        x, y = np.arange(width_px) + 0.5, np.arange(height_px) + 0.5
        ax.contour(x, y, inside, levels=[0.5], colors=color, linewidths=width)
