"""Missed instances and false alarms of detections at a working point.

The working point is a threshold on the score. It has the best F1 (harmonic mean of precision and
recall at an overlap of 0.5) over all classes in the evaluated scenes. Therefore results in other
scenes are slightly worse.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from pycocotools import mask as coco_mask

from ...base.public_value import public_value
from .matching import ClassMatches, Overlaps, shapes

AT_HALF = 0  # index of the overlap 0.5 in THRESHOLDS
NEAR = 0.1  # A detection with a smaller overlap belongs to no instance.

Why = Literal["found twice", "badly placed", "another class", "nothing there"]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class WorkingPoint:
    """A threshold on the score, with precision and recall at an overlap of 0.5."""

    score: float
    precision: float
    recall: float


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Miss:
    """An instance to find that no detection matches.

    `scene` is an index among the scenes, `instance` an index in the scene's `Labels`. `overlap` and
    `score` come from the detection (of any class) with the largest overlap; 0 and NaN if none.
    """

    scene: int
    instance: int
    overlap: float
    score: float


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class FalseAlarm:
    """A detection that matches no instance to find; `why` is the reason, with its `overlap`."""

    scene: int
    detection: int
    score: float
    why: Why
    overlap: float


def working_point(matches: Mapping[int, ClassMatches]) -> WorkingPoint:
    """Return the working point with the best F1; NaN without instances to find or detections."""
    wanted = sum(int(one.to_find.sum()) for one in matches.values())
    score = np.concatenate([np.empty(0), *(one.score for one in matches.values())])
    if not wanted or not len(score):
        nan = float("nan")
        return WorkingPoint(score=nan, precision=nan, recall=0.0 if wanted else nan)
    order = np.argsort(-score, kind="stable")
    hit = np.concatenate([one.hit[AT_HALF] for one in matches.values()])[order]
    counted = np.concatenate([one.counted[AT_HALF] for one in matches.values()])[order]
    last = np.append(np.diff(score[order]) < 0, True)  # Equal scores are above the same thresholds.
    hits, counts = np.cumsum(hit)[last], np.cumsum(counted)[last]
    best = int(np.argmax(2 * hits / (counts + wanted)))
    return WorkingPoint(
        score=float(score[order][last][best]),
        precision=float(hits[best] / counts[best]) if counts[best] else float("nan"),
        recall=float(hits[best] / wanted),
    )


def misses(known: Overlaps, matches: Mapping[int, ClassMatches], least: float) -> list[Miss]:
    """Return the instances that no detection with a score >= `least` finds, most visible first."""
    hits = {
        (int(scene), int(instance))
        for one in matches.values()
        for scene, instance in zip(
            one.scene[one.score >= least], one.instance[AT_HALF, one.score >= least], strict=True
        )
    }
    missed = [
        _miss(known, scene, i)
        for scene, labels in enumerate(known.labels)
        for i in np.flatnonzero(~labels.ignored).tolist()
        if (scene, i) not in hits
    ]
    return sorted(missed, key=lambda one: (-_visible(known, one), one.scene, one.instance))


def false_alarms(
    known: Overlaps, matches: Mapping[int, ClassMatches], least: float
) -> list[FalseAlarm]:
    """Return the false alarms with a score of `least` or more, by descending score."""
    alarms = []
    for one in matches.values():
        wrong = one.counted[AT_HALF] & ~one.hit[AT_HALF] & (one.score >= least)
        for i in np.flatnonzero(wrong).tolist():
            scene, detection = int(one.scene[i]), int(one.detection[i])
            why, overlap = _why(known, scene, detection)
            alarms.append(
                FalseAlarm(
                    scene=scene,
                    detection=detection,
                    score=float(one.score[i]),
                    why=why,
                    overlap=overlap,
                )
            )
    return sorted(alarms, key=lambda one: (-one.score, one.scene, one.detection))


def _miss(known: Overlaps, scene: int, instance: int) -> Miss:
    detections = known.detections[scene]
    overlap = _overlaps(known, scene, np.arange(len(detections)), np.array([instance]))[:, 0]
    nearest = int(overlap.argmax()) if overlap.any() else -1
    return Miss(
        scene=scene,
        instance=instance,
        overlap=0.0 if nearest < 0 else float(overlap[nearest]),
        score=float("nan") if nearest < 0 else float(detections.score[nearest]),
    )


def _visible(known: Overlaps, miss: Miss) -> float:
    """Return the instance's visible share or, if it is unknown, the area of its box."""
    labels = known.labels[miss.scene]
    if labels.visib_fract is not None:
        return float(labels.visib_fract[miss.instance])
    return float(labels.box_px[miss.instance, 2:].prod())


def _why(known: Overlaps, scene: int, detection: int) -> tuple[Why, float]:
    labels, detections = known.labels[scene], known.detections[scene]
    every = np.arange(len(labels))
    overlap = _overlaps(known, scene, np.array([detection]), every)[0]
    same = labels.obj_id == detections.obj_id[detection]
    own = float(overlap[same].max(initial=0.0))
    other = float(overlap[~same].max(initial=0.0))
    if own >= 0.5:
        return "found twice", own
    if other >= 0.5:
        return "another class", other
    if own >= NEAR:
        return "badly placed", own
    return "nothing there", max(own, other)


def _overlaps(
    known: Overlaps,
    scene: int,
    detection: Int[np.ndarray, " d"],
    instance: Int[np.ndarray, " g"],
) -> Float[np.ndarray, "d g"]:
    """Return the intersection over union of all pairs of detection and instance, of any class."""
    if not (len(detection) and len(instance)):
        return np.zeros((len(detection), len(instance)))
    instances, detections = shapes(known.labels[scene], known.detections[scene], known.kind)
    sides = [detections[i] for i in detection], [instances[i] for i in instance]
    return coco_mask.iou(*sides, [0] * len(instance))
