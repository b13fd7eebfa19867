"""The worst mistakes as crops of the pictures, with the outlines of both sides."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from pycocotools import mask as coco_mask

from ...base.plotting import INK, save_png
from .judging import Judgement
from .mistakes import NEAR, FalseAlarm, Miss

MOST_CROPS = 20
TRUTH_COLOR, DETECTION_COLOR = "#3ddc84", "#ff4d4d"
_COLUMNS = 5
_MARGIN = 0.6  # On each side it is a share of the longer side of what is shown.
_LEAST_PX = 48

Picture = Callable[[int], UInt8[np.ndarray, "h w 3"]]


def draw_misses(judgement: Judgement, picture: Picture, path: Path) -> None:
    """Draw the most visible instances that were missed; no file if there are none.

    Raises:
        GraycastError: the file cannot be written.
    """
    crops = judgement.misses[:MOST_CROPS]
    least = judgement.point.score
    threshold = "" if np.isnan(least) else f"; red: what was found from a score of {least:.2f} on"
    titles = []
    for miss in crops:
        labels = judgement.known.labels[miss.scene]
        known = "" if labels.visib_fract is None else f", {labels.visib_fract[miss.instance]:.0%}"
        head = f"scene {labels.scene_id}{known}{' visible' if known else ''}"
        titles.append(f"{head}\n{_nearest(miss)}")
    heading = f"{len(judgement.misses)} missed (green){threshold}"
    _draw_sheet(judgement, dict(zip(crops, titles, strict=True)), heading, picture, path)


def draw_false_alarms(judgement: Judgement, picture: Picture, path: Path) -> None:
    """Draw the detections with the highest scores that found nothing; no file if there are none.

    Raises:
        GraycastError: the file cannot be written.
    """
    crops = {
        alarm: f"scene {judgement.known.labels[alarm.scene].scene_id}, score {alarm.score:.2f}\n"
        f"{alarm.why}, overlap {alarm.overlap:.2f}"
        for alarm in judgement.false_alarms[:MOST_CROPS]
    }
    heading = f"{len(judgement.false_alarms)} false alarms (red); green: what is there"
    _draw_sheet(judgement, crops, heading, picture, path)


def _nearest(miss: Miss) -> str:
    if miss.overlap < NEAR:
        return "nothing was found near it"
    return f"nearest: overlap {miss.overlap:.2f}, score {miss.score:.2f}"


def _draw_sheet(
    judgement: Judgement,
    crops: Mapping[Miss, str] | Mapping[FalseAlarm, str],
    heading: str,
    picture: Picture,
    path: Path,
) -> None:
    """Crops of mistakes, each with its title, on one sheet."""
    if not crops:
        return
    rows = -(-len(crops) // _COLUMNS)
    figure = Figure(figsize=(2.3 * _COLUMNS, 2.6 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, squeeze=False).ravel().tolist()
    for ax in axes:
        ax.set_axis_off()
    figure.suptitle(heading, fontsize=9, color=INK, x=0.01, ha="left")
    for ax, (mistake, title) in zip(axes, crops.items(), strict=False):
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
    """Left, top, right, bottom of a square around a box, cut off where the picture ends."""
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
