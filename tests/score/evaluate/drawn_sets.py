"""Labels and detections: squares at given places, and random sets in the format of COCO's files."""

from dataclasses import dataclass

import numpy as np
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from graycast.dataset.read.detections import Detections
from graycast.score.evaluate import Labels
from graycast.score.evaluate.labels import run_lengths_of

SIZE_PX = (48, 64)
IOU_TYPE = {"box": "bbox", "mask": "segm"}


def squares(scene_id, places, *, visible=None, obj_id=1, side=8, masked=True):
    """Return labels of squares whose top-left pixels are `places` (x, y)."""
    count = len(places)
    visible = np.ones(count) if visible is None else np.array(visible, float)
    return Labels(
        scene_id=scene_id,
        scene=scene_id,
        size_px=SIZE_PX,
        obj_id=np.broadcast_to(obj_id, count).astype(np.int64).copy(),
        box_px=_boxes(places, side),
        mask=_masks(places, side) if masked else None,
        ignored=visible < 0.1,
        visib_fract=visible,
    )


def detected_squares(scene_id, places, scores, *, obj_id=1, side=8, masked=True):
    """Return detections of such squares, in descending order of score."""
    return Detections(
        scene_id=scene_id,
        score=np.array(scores, float),
        obj_id=np.broadcast_to(obj_id, len(places)).astype(np.int64).copy(),
        box_px=_boxes(places, side),
        mask=_masks(places, side) if masked else None,
    )


def _boxes(places, side):
    return np.array([[x, y, side, side] for x, y in places], np.float32).reshape(-1, 4)


def _masks(places, side):
    mask = np.zeros((len(places), *SIZE_PX), bool)
    for i, (x, y) in enumerate(places):
        mask[i, y : y + side, x : x + side] = True
    return run_lengths_of(mask)


@dataclass(frozen=True)
class RandomSet:
    """Scenes of disks, some hidden, and detections: shifted, repeated, false, of other classes.

    In every second set, scores have one digit, so that many scores are equal.
    """

    labels: list
    detections: list

    @classmethod
    def of_seed(cls, seed, scenes=4):
        rng = np.random.default_rng(seed)
        labels, detections = [], []
        for scene_id in range(scenes):
            disks = [_disk(rng) for _ in range(rng.integers(0, 8))]
            there = np.array(disks, bool).reshape(-1, *SIZE_PX)
            obj_id = rng.integers(1, 4, len(there))
            visible = rng.uniform(0, 1, len(there))
            labels.append(_labels(scene_id, there, obj_id, visible))
            masks, what = [_disk(rng) for _ in range(3)], list(rng.integers(1, 5, 3))
            for mask, obj in zip(there, obj_id, strict=True):
                for _ in range(rng.integers(0, 3)):
                    masks.append(np.roll(mask, rng.normal(0, 1.5, 2).astype(int), (0, 1)))
                    what.append(obj if rng.random() < 0.9 else rng.integers(1, 4))
            detections.append(
                _detections(scene_id, np.array(masks), np.array(what), rng, digits=1 + seed % 2 * 5)
            )
        return cls(labels, detections)

    def coco(self, kind, scenes=None):
        """Return truth and results as COCO's files; `scenes` are indices, which may repeat."""
        images, annotations, results = [], [], []
        for image_id, place in enumerate(range(len(self.labels)) if scenes is None else scenes):
            there, detected = self.labels[place], self.detections[place]
            images.append({"id": image_id, "height": SIZE_PX[0], "width": SIZE_PX[1]})
            annotations += [
                {
                    "id": len(annotations) + 1 + i,
                    "image_id": image_id,
                    "category_id": int(there.obj_id[i]),
                    "iscrowd": int(there.ignored[i]),
                    "area": int(coco_mask.area(there.mask[i])),
                    "bbox": there.box_px[i].astype(float).tolist(),
                    "segmentation": there.mask[i],
                }
                for i in range(len(there))
            ]
            results += [
                {
                    "image_id": image_id,
                    "category_id": int(detected.obj_id[i]),
                    "score": float(detected.score[i]),
                }
                | (
                    {"segmentation": detected.mask[i]}  # With a box, its area would be used.
                    if kind == "mask"
                    else {"bbox": detected.box_px[i].astype(float).tolist()}
                )
                for i in range(len(detected))
            ]
        classes = [{"id": i, "name": str(i)} for i in range(1, 5)]
        return {"images": images, "annotations": annotations, "categories": classes}, results

    def by_pycocotools(self, kind, most=300, areas=None, box_areas=False, scenes=None):
        """Return precision (t, r, classes) and recall (t, classes); -1 without instances."""
        truth = COCO()
        truth.dataset, results = self.coco(kind, scenes)
        for one in truth.dataset["annotations"] if box_areas else ():
            one["area"] = one["bbox"][2] * one["bbox"][3]
        truth.createIndex()
        judge = COCOeval(truth, truth.loadRes(results), IOU_TYPE[kind])
        judge.params.maxDets = [most]
        if areas is not None:
            judge.params.areaRng, judge.params.areaRngLbl = [areas], ["one"]
        judge.evaluate()
        judge.accumulate()
        return judge.eval["precision"][:, :, :, 0, -1], judge.eval["recall"][:, :, 0, -1]


def figures(precision, recall):
    """Return AP, AP50, AP75 and AR from the result of `by_pycocotools`; NaN where all are -1."""

    def mean(values):
        known = values[values > -1]
        return known.mean() if len(known) else np.nan

    return np.array([mean(precision), mean(precision[0]), mean(precision[5]), mean(recall)])


def ours(scores):
    return np.array([scores.ap, scores.ap50, scores.ap75, scores.ar])


def _disk(rng):
    y, x = np.mgrid[: SIZE_PX[0], : SIZE_PX[1]]
    radius = rng.uniform(3, 10)
    center = rng.uniform((6, 6), (SIZE_PX[0] - 6, SIZE_PX[1] - 6))
    return (y - center[0]) ** 2 + (x - center[1]) ** 2 <= radius**2


def _box_of(masks):
    boxes = [coco_mask.toBbox(runs) for runs in masks]
    return np.array(boxes, np.float32).reshape(-1, 4)


def _labels(scene_id, there, obj_id, visible):
    masks = run_lengths_of(there)
    return Labels(
        scene_id=scene_id,
        scene=scene_id,
        size_px=SIZE_PX,
        obj_id=obj_id,
        box_px=_box_of(masks),
        mask=masks,
        ignored=visible < 0.2,
        visib_fract=visible,
    )


def _detections(scene_id, disks, obj_id, rng, *, digits):
    masks = run_lengths_of(disks.astype(bool))
    score = rng.random(len(disks)).round(digits)
    order = np.argsort(-score, kind="stable")
    box = _box_of(masks)[order] + rng.normal(0, 0.5, (len(disks), 4)).astype(np.float32)
    box[:, 2:] = np.maximum(box[:, 2:], 1)
    return Detections(
        scene_id=scene_id,
        score=score[order],
        obj_id=obj_id[order].astype(np.int64),
        box_px=box,
        mask=tuple(masks[i] for i in order),
    )
