"""From labels and detections to all figures of them, for boxes and for masks."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from ...base.errors import GraycastError
from ...dataset.detections import Detections
from .groups import groups
from .intervals import DRAWS, Interval, differences, draw_scenes, with_intervals
from .labels import MIN_VISIBILITY, Labels
from .matching import Kind, Overlaps, match, overlaps
from .mistakes import FalseAlarm, Miss, WorkingPoint, false_alarms, misses, working_point
from .scores import MOST, Scores, score, scores_of

KINDS: tuple[Kind, ...] = ("box", "mask")


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """The choices of a judgement."""

    min_visibility: float = MIN_VISIBILITY
    most: int = MOST
    draws: int = DRAWS
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("most", 1), ("draws", 2)):
            if getattr(self, name) < least:
                raise GraycastError(f"{name} is {getattr(self, name)}: it must be {least} or more")
        if not 0 <= self.min_visibility < 1:
            raise GraycastError(
                f"min_visibility is {self.min_visibility}: give a share of at least 0 and less "
                "than 1"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupRow:
    """Figures of all instances, of a class or of a group.

    Attributes:
        by: `all`, `class`, or what the group is made by.
        name: the part's, or the group's.
        to_find: instances that count there.
        figures: `FIGURES` with their intervals.
    """

    by: str
    name: str
    to_find: int
    figures: Mapping[str, Interval]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """Everything about one kind of outline.

    Attributes:
        rows: all instances first, then classes, then groups.
        against: `FIGURES` less those of the other results; None where there are none.
        point: the working point that misses and false alarms are of.
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
    """What can be compared: boxes, and masks where both sides have them."""
    sides = (*labels, *(one for one in detections if len(one)))
    has_masks = all(one.mask is not None for one in sides)
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
    """All figures of one kind of outline.

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
