"""The matching of detections and instances by COCO's rule, for all thresholds at once.

Within a scene and a class the detections take, best score first, the instance that they overlap
most among those not yet taken, if they overlap it enough. An instance that counts goes before one
that is ignored; ignored ones can be taken by many. The rule is that of pycocotools 2.0
(`COCOeval.evaluateImg`), which is slow. faster-coco-eval 1.8 gives the matches of its lowest
threshold alone, knows no `Group`, and would take 4 to 8 s for 1000 draws that take 0.2 s here.
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
from ...dataset.detections import Detections
from .labels import Labels

Kind = Literal["box", "mask"]
THRESHOLDS = np.linspace(0.5, 0.95, 10)  # thresholds of intersection over union
THRESHOLDS.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A scene's instances and detections of one class, and how they overlap.

    `instance` and `detection` are places in the scene's `Labels` and `Detections`; detections are
    best first. `overlap` is intersection over union; over an ignored instance it is intersection
    over the detection's area, COCO's rule for crowds.
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
    """The overlaps of all detections and instances before the matching.

    Attributes:
        labels: labels in the order of their scenes' ids.
        detections: detections in the same scenes.
        most: how many detections of a scene and a class were looked at.
        pairs: for each class, the pairs in all scenes that have an instance or a detection of it.
    """

    kind: Kind
    most: int
    labels: tuple[Labels, ...]
    detections: tuple[Detections, ...]
    pairs: Mapping[int, tuple[Pair, ...]]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class ClassMatches:
    """Detections of a class over all scenes, best first, and what they found.

    Attributes:
        scene: place of each detection's scene among the scenes.
        detection: its place in that scene's `Detections`.
        instance: place in the scene's `Labels` of what it found, at each threshold; -1 for nothing.
        hit: whether that is an instance that was to be found.
        counted: whether it is a hit or a mistake; neither where it found something ignored.
        to_find: instances to be found in each scene.
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
        low, high: share from which and to which instances belong to it, without `high` except in
            the last group.
        other_instances: those outside, which are ignored there too; they overlap as before, not as
            crowds do.
        other_detections: detections that are no mistakes there if they find nothing.
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
        GraycastError: labels and detections are of different scenes or of pictures of different
            sizes, or one of them has no masks to compare.
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
    """Match every detection; classes are keyed by their object id."""
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
    """Return the boxes or run lengths of instances and of detections, to be compared."""
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
        ),  # row-major, because the kernels are compiled for it
        counted=np.concatenate(counted, axis=1).take(order, axis=1),
        to_find=to_find,
    )


@kernel()
def _take(overlap, ignored, shared, thresholds):
    """Return the place of the instance that each detection takes, for each threshold; -1 for none.

    Among equal overlaps the later instance is taken, as by pycocotools.
    """
    detections, instances = overlap.shape
    place = np.full((len(thresholds), detections), -1, dtype=np.int64)
    for t in range(len(thresholds)):
        taken = np.zeros(instances, dtype=np.bool_)
        for d in range(detections):
            for wanted in (False, True):  # Ignored objects are matched after those that count.
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
