"""Detections for the page: figures for the grid's filters, and outlines for each scene.

The match of a detection does not depend on detections with lower scores. Therefore a threshold on
the score only selects detections, which the page itself can do.
"""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from pycocotools import mask as coco_mask

from ....dataset.read.stored import StoredDataset
from ....score.evaluate import AT_HALF, Evaluation, Judgement, false_alarms
from ....score.evaluate import summary as evaluation_summary
from .packing import receiving

DETECTIONS = "detections.js"
_DIGITS = 4


def detection_index(evaluation: Evaluation, stored: StoredDataset) -> dict[str, Any]:
    """Return data for the grid's filters: instances to find, and scores of hits and mistakes.

    Matches are those of masks if there are masks, else those of boxes. Detections belong to
    pictures in `train/`, however these are divided into sets.
    """
    judgement = _judgement(evaluation)
    point = judgement.point
    rows: dict[str, Any] = {
        stored.picture(labels.scene_id).key: {
            "wanted": int((~labels.ignored).sum()),
            "hits": [],
            "mistakes": [],
        }
        for labels in judgement.known.labels
    }
    for matches in judgement.scores.matches.values():
        for i, scene in enumerate(matches.scene.tolist()):
            if matches.counted[AT_HALF, i]:
                row = rows[stored.picture(judgement.known.labels[scene].scene_id).key]
                kind = "hits" if matches.hit[AT_HALF, i] else "mistakes"
                row[kind].append(round(float(matches.score[i]), _DIGITS))
    return {
        "name": evaluation.run.name,
        "kind": judgement.kind,
        # The score is rounded down, so that the page still includes the detection with this score.
        "score": 0.5 if np.isnan(point.score) else float(np.floor(point.score * 100) / 100),
        "told": evaluation_summary(evaluation).splitlines(),
        "scenes": rows,
    }


def detection_scripts(evaluation: Evaluation, stored: StoredDataset) -> Iterator[tuple[str, bytes]]:
    """Yield (scene key, script with the scene's detections and the results of its instances)."""
    judgement = _judgement(evaluation)
    scenes = len(judgement.known.labels)
    detections: list[dict[int, dict[str, Any]]] = [{} for _ in range(scenes)]
    score_of_hit: list[dict[int, float]] = [{} for _ in range(scenes)]
    why = {
        (alarm.scene, alarm.detection): alarm.why
        for alarm in false_alarms(judgement.known, judgement.scores.matches, -np.inf)
    }
    for obj_id, matches in judgement.scores.matches.items():
        for i, (scene, place) in enumerate(
            zip(matches.scene.tolist(), matches.detection.tolist(), strict=True)
        ):
            taken = int(matches.instance[AT_HALF, i])
            hit, counted = matches.hit[AT_HALF, i], matches.counted[AT_HALF, i]
            detections[scene][place] = {
                "name": evaluation.categories.get(obj_id, str(obj_id)),
                "score": round(float(matches.score[i]), _DIGITS),
                "state": "hit" if hit else "mistake" if counted else "ignored",
                "why": why.get((scene, place)),
                "instance": _instance(judgement, scene, taken),
                **_outline(judgement, scene, place),
            }
            if hit:
                score_of_hit[scene][taken] = round(float(matches.score[i]), _DIGITS)
    for scene, labels in enumerate(judgement.known.labels):
        key = stored.picture(labels.scene_id).key
        instances = {
            str(_instance(judgement, scene, i)): {
                "found": score_of_hit[scene].get(i),
                "ignored": bool(labels.ignored[i]),
            }
            for i in range(len(labels))
        }
        of_scene = [one for _, one in sorted(detections[scene].items())]
        content = {"key": f"{key}/{DETECTIONS}", "detections": of_scene, "instances": instances}
        yield key, receiving(content)


def _judgement(evaluation: Evaluation) -> Judgement:
    return evaluation.judgements[-1]  # Masks come after boxes.


def _instance(judgement: Judgement, scene: int, place: int) -> int | None:
    """Return the index of an instance in `scene_gt.json`; None for a negative place."""
    labels = judgement.known.labels[scene]
    if place < 0:
        return None
    return place if labels.instance is None else int(labels.instance[place])


def _outline(judgement: Judgement, scene: int, place: int) -> dict[str, Any]:
    detections = judgement.known.detections[scene]
    box = detections.box_px[place]
    outline: dict[str, Any] = {"box": [round(float(edge), 1) for edge in box]}
    if judgement.kind == "mask" and detections.mask is not None:
        inside = coco_mask.decode(dict(detections.mask[place]))
        rings, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        outline["rings"] = [ring.reshape(-1).tolist() for ring in rings if len(ring) > 2]
    return outline
