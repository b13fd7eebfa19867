"""Drawings of detections: an enlarged crop around the detections, with outlines and scores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from pycocotools import mask as coco_mask

from ...dataset.read.detections import Detections

LEAST_SCORE = 0.5  # A detection is drawn from this score on.
_MARGIN = 0.08  # margin of a cut-out around the detections, as a share of its longer side
# Most detections have the first width; the drawing's longer side is between the second and third.
_LEAST_SIDE_PX, _WIDE_PX, _MOST_PX = 90, 1200, 2400
_FONT, _TEXT_SCALE, _PAD_PX = cv2.FONT_HERSHEY_SIMPLEX, 0.55, 4
_STEPS = 10  # A label that does not fit its detection moves away by up to this many label heights.
# Vivid colours in RGB. Neighbours in the list differ, because consecutive parts may touch.
_INKS = (
    (238, 102, 119), (34, 136, 221), (204, 187, 68), (170, 51, 119), (34, 160, 80),
    (255, 140, 20), (102, 204, 238), (120, 90, 220),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Cutout:
    """A crop of a picture in whole pixels (`right` and `bottom` are excluded), and its zoom."""

    left: int
    top: int
    right: int
    bottom: int
    factor: int


def draw_detections(
    image: UInt8[np.ndarray, "h w 3"], detections: Detections, names: Mapping[int, str]
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Draw the outlines and scores of the detections whose score is at least 0.5.

    Args:
        image: RGB picture.
        names: names of the object ids; if there are several, each score is preceded by a name.
    """
    count = int(np.count_nonzero(detections.score >= LEAST_SCORE))
    boxes = detections.box_px[:count]
    view = cutout_of(boxes, image.shape[1], image.shape[0])
    part = image[view.top : view.bottom, view.left : view.right]
    drawing = cv2.resize(part, None, fx=view.factor, fy=view.factor, interpolation=cv2.INTER_CUBIC)
    lines = [_outlines(detections, i, view) for i in range(count)]
    for dark in (True, False):  # All dark rims are drawn below all colours.
        for i, outline in enumerate(lines):
            ink = (20, 20, 20) if dark else _INKS[i % len(_INKS)]
            cv2.polylines(drawing, outline, True, ink, 4 if dark else 2, cv2.LINE_AA)
    texts = [f"{score:.2f}" for score in detections.score[:count]]
    if len(names) > 1:
        kinds = detections.obj_id[:count].tolist()
        texts = [f"{names.get(i, i)} {text}" for i, text in zip(kinds, texts, strict=True)]
    centers = (boxes[:, :2] + boxes[:, 2:] / 2 - (view.left, view.top)) * view.factor
    plates = plate_places(texts, centers, drawing.shape[1], drawing.shape[0])
    for i, (text, plate) in enumerate(zip(texts, plates, strict=True)):
        if plate is not None:
            _draw_plate(drawing, text, plate, _INKS[i % len(_INKS)], centers[i])
    return drawing


def cutout_of(boxes: Float[np.ndarray, "n 4"], width_px: int, height_px: int) -> Cutout:
    """Return a crop around the boxes, enlarged so that most boxes have room for a plate."""
    left, top, right, bottom = 0, 0, width_px, height_px
    if len(boxes):
        low, high = boxes[:, :2].min(axis=0), (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
        margin = max(_MARGIN * float((high - low).max()), 4.0)
        left, top = np.maximum(np.floor(low - margin), 0).astype(int).tolist()
        ends = np.minimum(np.ceil(high + margin), (width_px, height_px))
        right, bottom = np.maximum(ends, (left + 1, top + 1)).astype(int).tolist()
    longer = max(right - left, bottom - top)
    factor = _WIDE_PX / longer
    if len(boxes):
        factor = max(factor, _LEAST_SIDE_PX / max(float(np.median(boxes[:, 2:].min(axis=1))), 1.0))
    factor = int(np.clip(np.ceil(factor), 1, max(_MOST_PX // longer, 1)))
    return Cutout(left, top, right, bottom, factor)


def plate_places(
    texts: Sequence[str], centers: Float[np.ndarray, "n 2"], width_px: int, height_px: int
) -> list[tuple[int, int, int, int] | None]:
    """Return (left, top, right, bottom) of a plate for each text, close to the text's centre.

    The plates do not overlap and are inside the picture. The first texts are placed first; if there
    is no room for a text, its place is None.
    """
    places: list[tuple[int, int, int, int] | None] = []
    for text, (x, y) in zip(texts, centers.tolist(), strict=True):
        (columns, rows), below = cv2.getTextSize(text, _FONT, _TEXT_SCALE, 1)
        width, height = columns + 2 * _PAD_PX, rows + below + 2 * _PAD_PX
        steps = [
            (round(x - width / 2 + width * across / 2), round(y - height / 2 + height * down))
            for down in range(-_STEPS, _STEPS + 1)
            for across in range(-_STEPS, _STEPS + 1)
        ]
        steps.sort(key=lambda at: (at[0] + width / 2 - x) ** 2 + (at[1] + height / 2 - y) ** 2)
        plates = [(left, top, left + width, top + height) for left, top in steps]
        room = (
            one
            for one in plates
            if one[0] >= 0 and one[1] >= 0 and one[2] <= width_px and one[3] <= height_px
            if not any(other is not None and _overlap(one, other) for other in places)
        )
        places.append(next(room, None))
    return places


def _overlap(one: tuple[int, int, int, int], other: tuple[int, int, int, int]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _outlines(detections: Detections, i: int, view: Cutout) -> list[np.ndarray]:
    """Return the outlines of a mask, or of a box if there is no mask, in pixels of the drawing."""
    if detections.mask is None:
        x, y, columns, rows = detections.box_px[i]
        corners = np.array([[x, y], [x + columns, y], [x + columns, y + rows], [x, y + rows]])
        return [np.round((corners - (view.left, view.top)) * view.factor).astype(np.int32)]
    mask = coco_mask.decode(dict(detections.mask[i]))[
        view.top : view.bottom, view.left : view.right
    ]
    large = cv2.resize(255 * mask, None, fx=view.factor, fy=view.factor)
    outlines, _ = cv2.findContours(
        (large > 127).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    return list(outlines)


def _draw_plate(
    drawing: UInt8[np.ndarray, "h w 3"],
    text: str,
    plate: tuple[int, int, int, int],
    ink: tuple[int, int, int],
    center: Float[np.ndarray, "2"],
) -> None:
    """Draw text on a dark plate with a coloured rim, and a line to the centre if it is outside."""
    left, top, right, bottom = plate
    x, y = (round(float(value)) for value in center)
    if not (left <= x <= right and top <= y <= bottom):
        cv2.line(drawing, (x, y), ((left + right) // 2, (top + bottom) // 2), ink, 1, cv2.LINE_AA)
    cv2.rectangle(drawing, (left, top), (right - 1, bottom - 1), (25, 25, 28), -1)
    cv2.rectangle(drawing, (left, top), (right - 1, bottom - 1), ink, 1)
    (_, rows), _ = cv2.getTextSize(text, _FONT, _TEXT_SCALE, 1)
    place = (left + _PAD_PX, top + _PAD_PX + rows)
    cv2.putText(drawing, text, place, _FONT, _TEXT_SCALE, (255, 255, 255), 1, cv2.LINE_AA)
