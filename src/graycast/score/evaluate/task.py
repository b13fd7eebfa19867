"""Evaluate stored detections against the labels of a stored dataset."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import UInt8

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...dataset.export.record import RECORD, read_record
from ...dataset.export.split import Split
from ...dataset.read.detections import Detections
from ...dataset.read.example import display_image
from ...dataset.training import Examples, open_examples
from .judgement_files import Evaluation
from .judgement_plots import Picture
from .judging import Judgement, Protocol, judge, kinds_of
from .labels import Labels, labels_of
from .matching import ClassMatches, Kind
from .results import DetectionRun, open_run, read_detections
from .scores import precision_curves

_Either = TypeVar("_Either", Labels, Detections)
TELLING = 0.005  # A note is given if the order of equal scores changes AP by at least this.
_ONE_CLASS = 1  # object id of all instances if classes are ignored


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """An evaluation to run: the results, the dataset, and how to compare them.

    If `split` or `division` is None, it is read from the results. `one_class` ignores classes.
    """

    results: Path
    dataset: Path
    split: str | None = None
    division: Split | None = None
    against: Path | None = None
    kind: Kind | None = None
    one_class: bool = False
    protocol: Protocol = field(default_factory=Protocol)

    def __post_init__(self) -> None:
        check_fields(self)


def evaluate(task: Task, *, progress: ProgressMeter = UNWATCHED) -> tuple[Evaluation, Picture]:
    """Return the evaluation of results, and a reader of pictures (UInt8Array_h_w_3).

    Args:
        progress: counter of the scenes that are read.

    Raises:
        GraycastError: the dataset or the results are missing, damaged, or do not fit together.
    """
    run = open_run(task.results)
    against = None if task.against is None else open_run(task.against)
    sets = _sets(task, run)
    of_scene = {scene_id: examples for examples in sets for scene_id in examples.scene_ids}
    categories = dict(sets[0].categories)
    scene_ids = _scene_ids(task, run, of_scene)
    detections = read_detections(run, scene_ids, categories)
    other = None if against is None else read_detections(against, scene_ids, categories)
    labels = list(_labels(task, of_scene, scene_ids, progress))
    if task.one_class:
        labels = [as_one_class(one) for one in labels]
        detections = [as_one_class(one) for one in detections]
        other = None if other is None else [as_one_class(one) for one in other]
        categories = {_ONE_CLASS: "any part"}
    kinds = kinds_of(labels, [*detections, *(other or [])]) if task.kind is None else (task.kind,)
    judgements = tuple(
        judge(
            labels,
            detections,
            kind=kind,
            categories=categories,
            protocol=task.protocol,
            against=other,
        )
        for kind in kinds
    )
    evaluation = Evaluation(
        dataset=task.dataset.resolve().name,
        split=", ".join(examples.split for examples in sets),
        run=run,
        against=against,
        categories=categories,
        protocol=task.protocol,
        judgements=judgements,
        notes=tuple(notes(judgements)),
    )
    return evaluation, _pictures(of_scene)


def _sets(task: Task, run: DetectionRun) -> list[Examples]:
    """Return the set to evaluate, or all sets of an export if the results name no set."""
    split = task.split or run.split
    if not (task.dataset / RECORD).is_file():
        division = task.division or run.division
        return [open_examples(task.dataset, split=split or "train", division=division)]
    if split is None and run.scene_ids is not None:
        splits = read_record(task.dataset).splits
        return [open_examples(task.dataset, split=name) for name in splits]
    return [open_examples(task.dataset, split=split or "train", division=task.division)]


def _scene_ids(task: Task, run: DetectionRun, of_scene: Mapping[int, Examples]) -> tuple[int, ...]:
    """Return the ids of the detector's scenes, or of all scenes of the set that the task names."""
    if run.scene_ids is None or task.split is not None:
        return tuple(of_scene)
    if odd := set(run.scene_ids) - set(of_scene):
        split = next(iter(of_scene.values())).split
        raise GraycastError(
            f"{run.path}: has detections in scene {min(odd)}, which the set {split} of "
            f"{task.dataset} does not have: give the dataset of the detections with --on"
        )
    return run.scene_ids


def _labels(
    task: Task,
    of_scene: Mapping[int, Examples],
    scene_ids: Sequence[int],
    progress: ProgressMeter,
) -> Iterator[Labels]:
    for done, scene_id in enumerate(scene_ids, start=1):
        example = of_scene[scene_id].read(scene_id)
        yield labels_of(
            example,
            min_visibility=task.protocol.min_visibility,
            scene=of_scene[scene_id].place_of[scene_id][0],
        )
        progress.count("scenes", done, len(scene_ids))


def as_one_class(one: _Either) -> _Either:
    """Return labels or detections with the same class for all instances."""
    return replace(one, obj_id=np.full(len(one), _ONE_CLASS))


def _pictures(of_scene: Mapping[int, Examples]) -> Picture:
    @lru_cache(maxsize=64)
    def picture(scene_id: int) -> UInt8[np.ndarray, "h w 3"]:
        return display_image(of_scene[scene_id].read(scene_id))

    return picture


# --- notes on the results -------------------------------------------------------------------------


def notes(judgements: Sequence[Judgement]) -> Iterator[str]:
    """Yield warnings about repeated detections and about equal scores that affect AP."""
    if doubled := sum(map(_doubled, judgements[0].known.detections)):
        yield (
            f"{doubled} detections repeat another one (same picture, class and outline), and each "
            "counts as a false alarm: remove them from the results."
        )
    for one in judgements:
        low, high = ap_of_any_order(one.scores.matches)
        if high - low < TELLING:
            continue
        score = np.concatenate([each.score for each in one.scores.matches.values()])
        equal = "all scores are equal" if len(set(score.tolist())) == 1 else "scores are equal"
        yield (
            f"{one.kind}: {equal}, so that AP depends on the order of the detections in the file: "
            f"it is {one.scores.ap:.3f}, and another order could make it {low:.3f} to {high:.3f}."
        )


def ap_of_any_order(matches: Mapping[int, ClassMatches]) -> tuple[float, float]:
    """Return AP if mistakes precede hits of equal scores, and AP if hits precede mistakes.

    The detections are not matched again, although another order in a picture could change this.
    """
    worst, best = (
        [float(precision_curves(_sorted(one, sign)).mean()) for one in matches.values()]
        for sign in (1, -1)
    )
    known = ~np.isnan(worst)
    if not known.any():
        return float("nan"), float("nan")
    return float(np.mean(np.array(worst)[known])), float(np.mean(np.array(best)[known]))


def _sorted(one: ClassMatches, sign: int) -> ClassMatches:
    """Return matches with hits after mistakes of the same score (sign 1), or before (sign -1)."""
    order = np.stack([np.lexsort((sign * hit, -one.score)) for hit in one.hit.astype(int)])
    return replace(
        one,
        hit=np.take_along_axis(one.hit, order, axis=1),
        counted=np.take_along_axis(one.counted, order, axis=1),
    )


def _doubled(detections: Detections) -> int:
    """Count the detections that repeat the class, box and mask of an earlier detection."""
    masks = (
        [None] * len(detections)
        if detections.mask is None
        else [str(m["counts"]) for m in detections.mask]
    )
    outlines = zip(
        detections.obj_id.tolist(), map(tuple, detections.box_px.tolist()), masks, strict=True
    )
    return sum(count - 1 for count in Counter(outlines).values())
