"""Compare detections with labels, for boxes and for masks, over all instances and by groups.

Instances outside a group are ignored: a detector need not find them, and a detection that matches
such an instance is neither a hit nor a mistake. Their overlap is still intersection over union, so
a detection that overlaps no instance enough is a mistake in every group. Groups by size are an
exception: a detection without a match is a mistake only in the group of its own size, as in COCO.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from pycocotools import mask as coco_mask

from ...base.errors import GraycastError
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...dataset.read.detections import Detections
from .intervals import DRAWS, Interval, differences, draw_scenes, with_intervals
from .labels import MIN_VISIBILITY, Labels
from .matching import Group, Kind, Overlaps, match, overlaps
from .mistakes import FalseAlarm, Miss, WorkingPoint, false_alarms, misses, working_point
from .scores import MOST, Scores, score, scores_of

VISIBILITY_EDGES = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
# Edges are shares of the picture's area; each edge is four times the previous one.
AREA_EDGES = (0.0, 0.001, 0.004, 0.016, 0.064, 1.0)
MISSING_EDGES = (0.0, 0.05, 0.2, 0.5, 1.0)
KINDS: tuple[Kind, ...] = ("box", "mask")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """Parameters of a comparison."""

    min_visibility: float = MIN_VISIBILITY
    most: int = MOST
    draws: int = DRAWS
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, least in (("most", 1), ("draws", 2)):
            if getattr(self, name) < least:
                raise GraycastError(f"{name} is {getattr(self, name)}: it must be {least} or more")
        if not 0 <= self.min_visibility < 1:
            raise GraycastError(
                f"min_visibility is {self.min_visibility}: give a share of at least 0 and less "
                "than 1"
            )


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class GroupRow:
    """Figures over all instances, over a class or over a group.

    Attributes:
        by: `all`, `class`, or the quantity that defines the group.
        name: name of the part or group.
        to_find: number of instances to find.
        figures: `FIGURES` of detection or pose scores, with their intervals.
    """

    by: str
    name: str
    to_find: int
    figures: Mapping[str, Interval]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """All results for boxes, or all for masks.

    Attributes:
        rows: figures over all instances, then over each class, then over each group.
        against: differences of `FIGURES` from another file of results; None without such a file.
        point: working point at which `misses` and `false_alarms` are listed.
    """

    kind: Kind
    known: Overlaps
    scores: Scores
    rows: tuple[GroupRow, ...]
    against: Mapping[str, Interval] | None
    point: WorkingPoint
    misses: tuple[Miss, ...]
    false_alarms: tuple[FalseAlarm, ...]


def kinds_of(labels: Sequence[Labels], detections: Sequence[Detections]) -> tuple[Kind, ...]:
    """Return the kinds to compare: boxes, and masks if both labels and detections have masks."""
    has_masks = all(one.mask is not None for one in labels)
    has_masks &= all(one.mask is not None for one in detections if len(one))
    return KINDS if has_masks and any(map(len, detections)) else ("box",)


def judge(
    labels: Sequence[Labels],
    detections: Sequence[Detections],
    *,
    kind: Kind,
    categories: Mapping[int, str],
    protocol: Protocol,
    against: Sequence[Detections] | None = None,
) -> Judgement:
    """Compare detections with labels by one kind of outline, and return all figures.

    Raises:
        GraycastError: labels and detections do not fit together.
    """
    known = overlaps(labels, detections, kind=kind, most=protocol.most)
    scene_of = [one.scene for one in known.labels]
    times = draw_scenes(scene_of, seed=protocol.seed, draws=protocol.draws)
    scores = scores_of(match(known), known)
    gap = None
    if against is not None:
        other = score(labels, against, kind=kind, most=protocol.most)
        gap = differences(scores, other, times)
    point = working_point(scores.matches)
    least = float("inf") if np.isnan(point.score) else point.score
    return Judgement(
        kind=kind,
        known=known,
        scores=scores,
        rows=tuple(_rows(known, scores, times, categories, protocol)),
        against=gap,
        point=point,
        misses=tuple(misses(known, scores.matches, least)),
        false_alarms=tuple(false_alarms(known, scores.matches, least)),
    )


def _rows(
    known: Overlaps,
    scores: Scores,
    times: Int[np.ndarray, "draws pictures"],
    categories: Mapping[int, str],
    protocol: Protocol,
) -> Iterator[GroupRow]:
    yield _group_scores("all", "all", scores, times)
    if len(scores.matches) > 1:
        for obj_id, one in scores.matches.items():
            alone = scores_of({obj_id: one}, known)
            yield _group_scores("class", categories.get(obj_id, str(obj_id)), alone, times)
    for group in groups(known.labels, kind=known.kind, min_visibility=protocol.min_visibility):
        inside = scores_of(match(known, group), known)
        yield _group_scores(group.by, group.name, inside, times)


def _group_scores(
    by: str, name: str, scores: Scores, times: Int[np.ndarray, "draws pictures"]
) -> GroupRow:
    return GroupRow(by=by, name=name, to_find=scores.to_find, figures=with_intervals(scores, times))


# --- groups -------------------------------------------------------------------------------------


def groups(labels: Sequence[Labels], *, kind: Kind, min_visibility: float) -> Iterator[Group]:
    """Yield groups by visibility, size and missing depth, if the labels have that quantity."""
    if all(one.visib_fract is not None for one in labels):
        above = [edge for edge in VISIBILITY_EDGES if edge > min_visibility]
        for low, high in pairwise([min_visibility, *above]):
            yield _group("visibility", low, high, lambda one: one.visib_fract)
    if all(one.size_px is not None for one in labels):
        pixels = {one.scene_id: one.size_px[0] * one.size_px[1] for one in labels if one.size_px}

        def share(one: Labels | Detections) -> Float[np.ndarray, " n"]:
            return _area_px2(one, kind) / pixels[one.scene_id]

        for low, high in pairwise(AREA_EDGES):
            # A box may extend beyond the picture, so its share may exceed 1.
            yield _group("size", low, high, share, lambda one: np.minimum(share(one), 1.0))
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


def _area_px2(one: Labels | Detections, kind: Kind) -> Float[np.ndarray, " n"]:
    if kind == "mask":
        return np.array([coco_mask.area(dict(mask)) for mask in one.mask or ()], dtype=float)
    return one.box_px[:, 2].astype(float) * one.box_px[:, 3]
