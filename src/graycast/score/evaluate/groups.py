"""Figures by groups of instances: by visibility, by size, by the scanner's holes.

Instances outside a group are ignored: they need not be found, and what finds one is neither a hit
nor a mistake. They overlap as ever (intersection over union), so a bad outline of one is a mistake
in every group, as is a detection of nothing. By size alone detections have a group of their own,
and a mistake counts there alone, as COCO has it.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from pycocotools import mask as coco_mask

from ...dataset.detections import Detections
from .labels import Labels
from .matching import Group, Kind

VISIBILITY_EDGES = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
AREA_EDGES = (
    0.0,
    0.001,
    0.004,
    0.016,
    0.064,
    1.0,
)  # They are shares of the picture, each four times the last.
MISSING_EDGES = (0.0, 0.05, 0.2, 0.5, 1.0)


def groups(labels: Sequence[Labels], *, kind: Kind, min_visibility: float) -> Iterator[Group]:
    """The groups that the labels allow; an unknown share makes no groups."""
    if all(one.visib_fract is not None for one in labels):
        above = [edge for edge in VISIBILITY_EDGES if edge > min_visibility]
        for low, high in pairwise([min_visibility, *above]):
            yield _group("visibility", low, high, lambda one: one.visib_fract)
    sizes = {one.size_px for one in labels}
    if None not in sizes:
        area = partial(_label_area, kind=kind)
        pixels = {one.scene_id: one.size_px[0] * one.size_px[1] for one in labels if one.size_px}
        detection_area = partial(_detection_area, kind=kind, pixels=pixels)
        for low, high in pairwise(AREA_EDGES):
            yield _group("size", low, high, area, detection_area)
    if all(one.missing is not None for one in labels):
        for low, high in pairwise(MISSING_EDGES):
            yield _group("missing depth", low, high, lambda one: one.missing)


def _group(
    by: str,
    low: float,
    high: float,
    label_share: Callable[[Labels], Float[np.ndarray, " n"] | None],
    detection_share: Callable[[Detections], Float[np.ndarray, " n"]] | None = None,
) -> Group:
    def outside(share: Float[np.ndarray, " n"] | None) -> Bool[np.ndarray, " n"]:
        if share is None:
            raise ValueError(f"these labels do not know their {by}")
        return (share < low) | ((share > high) if high == 1.0 else (share >= high))

    return Group(
        by=by,
        low=low,
        high=high,
        other_instances=lambda one: outside(label_share(one)),
        other_detections=None
        if detection_share is None
        else lambda one: outside(detection_share(one)),
    )


def _label_area(one: Labels, *, kind: Kind) -> Float[np.ndarray, " n"]:
    """Share of the picture that each instance's visible mask, or its box, covers."""
    height_px, width_px = one.size_px or (0, 0)
    return _area_px2(one, kind) / (height_px * width_px)


def _detection_area(
    one: Detections, *, kind: Kind, pixels: dict[int, int]
) -> Float[np.ndarray, " n"]:
    """The same of detections; a box that reaches beyond the picture covers no more than it."""
    return np.minimum(_area_px2(one, kind) / pixels[one.scene_id], 1.0)


def _area_px2(one: Labels | Detections, kind: Kind) -> Float[np.ndarray, " n"]:
    if kind == "mask":
        return np.array([coco_mask.area(dict(mask)) for mask in one.mask or ()], dtype=float)
    return one.box_px[:, 2].astype(float) * one.box_px[:, 3]
