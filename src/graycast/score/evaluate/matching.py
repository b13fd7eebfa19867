"""Match detections and instances by COCO's rule, for all thresholds at once.

Within a scene and a class, detections choose in descending order of their scores. Each takes the
free instance that it overlaps most, if the overlap reaches the threshold. Instances that count take
precedence over ignored instances, which several detections can take. The rule is that of
pycocotools 2.0 (`COCOeval.evaluateImg`), which is slow. faster-coco-eval 1.8 has no `Group`,
returns matches only at its lowest threshold, and needs 4 to 8 s for 1000 draws (here 0.2 s).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pycocotools import mask as coco_mask

from ...base.errors import GraycastError
from ...base.kernels import kernel
from ...base.public_value import public_value
from ...dataset.read.detections import Detections
from .labels import Labels

Kind = Literal["box", "mask"]
THRESHOLDS = np.linspace(0.5, 0.95, 10)  # thresholds of intersection over union
THRESHOLDS.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """The instances and detections of one class in a scene, and their overlaps.

    `instance` and `detection` are indices into the scene's `Labels` and `Detections`. Detections
    are in descending order of score. `overlap` is intersection over union or, for ignored
    instances, intersection over the detection's area, as for crowds in COCO.
    """

    scene: int
    instance: Int[np.ndarray, " g"]
    detection: Int[np.ndarray, " d"]
    score: Float[np.ndarray, " d"]
    ignored: Bool[np.ndarray, " g"]
    overlap: Float[np.ndarray, "d g"]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Overlaps:
    """The overlaps between all detections and instances, before the matching.

    Attributes:
        labels: labels in the order of scene ids.
        detections: detections in the same order.
        most: largest number of detections of a class in a scene; others are left out.
        pairs: for each class, a `Pair` for each scene with an instance or a detection of the class.
    """

    kind: Kind
    most: int
    labels: tuple[Labels, ...]
    detections: tuple[Detections, ...]
    pairs: Mapping[int, tuple[Pair, ...]]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class ClassMatches:
    """Detections of a class over all scenes, by descending score, and the instances they match.

    Attributes:
        scene: index of each detection's scene among the scenes.
        detection: index of the detection in the scene's `Detections`.
        instance: index of the matched instance in the scene's `Labels`, by threshold; -1 if none.
        hit: whether the matched instance is an instance to find.
        counted: whether the detection is a hit or a mistake; False if its match is ignored.
        to_find: number of instances to find in each scene.
    """

    scene: Int[np.ndarray, " n"]
    detection: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    instance: Int[np.ndarray, "t n"]
    hit: Bool[np.ndarray, "t n"]
    counted: Bool[np.ndarray, "t n"]
    to_find: Int[np.ndarray, " scenes"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """A group of instances, such as all large ones.

    Attributes:
        by: quantity that defines the group.
        low, high: limits of the group's shares; only the last group includes `high`.
        other_instances: function that returns a mask of the instances outside the group. They are
            ignored, but their overlap is still intersection over union, unlike for COCO's crowds.
        other_detections: function that returns a mask of the detections that are no mistakes in
            the group if they match no instance; None if all such detections are mistakes.
    """

    by: str
    low: float
    high: float
    other_instances: Callable[[Labels], Bool[np.ndarray, " n"]]
    other_detections: Callable[[Detections], Bool[np.ndarray, " n"]] | None = None

    @property
    def name(self) -> str:
        return f"{100 * self.low:g} to {100 * self.high:g} %"


def overlaps(
    labels: Sequence[Labels], detections: Sequence[Detections], *, kind: Kind, most: int
) -> Overlaps:
    """Compare every detection with every instance of its scene and class.

    Raises:
        GraycastError: labels and detections have different scenes or different picture sizes, or
            masks are missing in one of them.
    """
    if most < 1:
        raise ValueError(f"most is {most}; give at least 1")
    by_scene = {one.scene_id: one for one in detections}
    ordered = sorted(labels, key=lambda one: one.scene_id)
    scene_ids = [one.scene_id for one in ordered]
    _check_scenes(scene_ids, [one.scene_id for one in detections])
    detections = [by_scene[scene_id] for scene_id in scene_ids]
    pairs: dict[int, list[Pair]] = {}
    for scene, (there, of_scene) in enumerate(zip(ordered, detections, strict=True)):
        both = shapes(there, of_scene, kind)
        for obj_id in np.union1d(there.obj_id, of_scene.obj_id).tolist():
            pair = _pair(scene, there, of_scene, obj_id, both, most)
            pairs.setdefault(obj_id, []).append(pair)
    return Overlaps(
        kind=kind,
        most=most,
        labels=tuple(ordered),
        detections=tuple(detections),
        pairs={obj_id: tuple(values) for obj_id, values in sorted(pairs.items())},
    )


def match(known: Overlaps, group: Group | None = None) -> dict[int, ClassMatches]:
    """Match all detections of each class, and return the matches by object id."""
    return {obj_id: _match_class(known, pairs, group) for obj_id, pairs in known.pairs.items()}


def _check_scenes(labelled: list[int], detected: list[int]) -> None:
    for what, ids in (("labels", labelled), ("detections", detected)):
        if len(set(ids)) < len(ids):
            twice = next(i for i in ids if ids.count(i) > 1)
            raise GraycastError(f"scene {twice} has {what} twice: give each scene once")
    if odd := set(labelled) ^ set(detected):
        lacks = "detections" if min(odd) in labelled else "labels"
        raise GraycastError(
            f"scene {min(odd)} has no {lacks}: give labels and detections of the same scenes, "
            "including scenes without detections"
        )


def shapes(there: Labels, of_scene: Detections, kind: Kind) -> tuple[list[Any], list[Any]]:
    """Return the outlines (boxes or run lengths) of the instances and of the detections."""
    if kind == "box":
        return there.box_px.astype(float).tolist(), of_scene.box_px.astype(float).tolist()
    if there.mask is None:
        raise GraycastError(
            f"scene {there.scene_id}: its labels have no masks: score boxes with --kind, or add "
            "masks to the labels"
        )
    if of_scene.mask is None and len(of_scene):
        raise GraycastError(
            f"scene {there.scene_id}: its detections have no masks: score boxes with --kind, or "
            "use a detector that finds masks"
        )
    for mask in of_scene.mask or ():
        if there.size_px is not None and tuple(mask["size"]) != there.size_px:
            raise GraycastError(
                f"scene {there.scene_id}: a detection's mask is of {mask['size'][1]} x "
                f"{mask['size'][0]} pixels, the picture has {there.size_px[1]} x "
                f"{there.size_px[0]}: give results of this dataset"
            )
    return list(there.mask), list(of_scene.mask or ())


def _pair(
    scene: int,
    there: Labels,
    of_scene: Detections,
    obj_id: int,
    both: tuple[list[Any], list[Any]],
    most: int,
) -> Pair:
    instance = np.flatnonzero(there.obj_id == obj_id)
    of_class = np.flatnonzero(of_scene.obj_id == obj_id)
    detection = of_class[np.argsort(-of_scene.score[of_class], kind="stable")][:most]
    ignored = there.ignored[instance]
    overlap = np.zeros((len(detection), len(instance)))
    if overlap.size:
        overlap = coco_mask.iou(
            [both[1][i] for i in detection],
            [both[0][i] for i in instance],
            ignored.astype(int).tolist(),
        )
    return Pair(
        scene=scene,
        instance=instance,
        detection=detection,
        score=of_scene.score[detection].astype(np.float64),
        ignored=ignored,
        overlap=np.ascontiguousarray(overlap, dtype=np.float64),
    )


def _match_class(known: Overlaps, pairs: tuple[Pair, ...], group: Group | None) -> ClassMatches:
    to_find = np.zeros(len(known.labels), dtype=np.int64)
    instance, hit, counted = [], [], []
    for pair in pairs:
        ignored = pair.ignored.copy()
        beside = np.zeros(len(pair.detection), dtype=bool)
        if group is not None:
            ignored |= group.other_instances(known.labels[pair.scene])[pair.instance]
            if group.other_detections is not None:
                beside = group.other_detections(known.detections[pair.scene])[pair.detection]
        to_find[pair.scene] = np.count_nonzero(~ignored)
        place = _take(pair.overlap, ignored, pair.ignored, THRESHOLDS)
        taken = place >= 0
        of_ignored = taken & np.append(ignored, False)[place]
        instance.append(np.append(pair.instance, -1)[place])
        hit.append(taken & ~of_ignored)
        counted.append(~of_ignored & (taken | ~beside))
    score = np.concatenate([pair.score for pair in pairs])
    order = np.argsort(-score, kind="stable")
    return ClassMatches(
        scene=np.repeat([p.scene for p in pairs], [len(p.detection) for p in pairs])[order],
        detection=np.concatenate([pair.detection for pair in pairs])[order],
        score=score[order],
        instance=np.concatenate(instance, axis=1)[:, order],
        hit=np.concatenate(hit, axis=1).take(
            order, axis=1
        ),  # The kernels are compiled for row-major arrays.
        counted=np.concatenate(counted, axis=1).take(order, axis=1),
        to_find=to_find,
    )


@kernel()
def _take(overlap, ignored, shared, thresholds):
    """Return the index of the instance that each detection takes at each threshold; -1 if none.

    Among equal overlaps, the last instance is taken, as in pycocotools.
    """
    detections, instances = overlap.shape
    place = np.full((len(thresholds), detections), -1, dtype=np.int64)
    for t in range(len(thresholds)):
        taken = np.zeros(instances, dtype=np.bool_)
        for d in range(detections):
            for wanted in (False, True):  # Instances that count take precedence over ignored ones.
                best = min(thresholds[t], 1 - 1e-10)
                for g in range(instances):
                    if ignored[g] != wanted or (taken[g] and not shared[g]):
                        continue
                    if overlap[d, g] >= best:
                        best = overlap[d, g]
                        place[t, d] = g
                if place[t, d] >= 0:
                    break
            if place[t, d] >= 0:
                taken[place[t, d]] = True
    return place
