"""A run's detections for the page: counts of every scene for the grid, outlines for a scene.

A detection takes the same instance whatever worse ones there are, so all that a score to count from
changes is which detections are looked at: the page does that itself.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pycocotools import mask as coco_mask

from ....base.progress import UNWATCHED, ProgressMeter
from ....dataset.stored import StoredDataset
from ....score.evaluate import (
    AT_HALF,
    Evaluation,
    Judgement,
    Protocol,
    Task,
    evaluate,
    false_alarms,
)
from ....score.evaluate import summary as evaluation_summary

FOUND = "detections.js"
_DIGITS = 4


def evaluation_of(
    dataset: Path, results: Path, *, progress: ProgressMeter = UNWATCHED
) -> Evaluation:
    """The results, judged by the dataset with the usual choices.

    Raises:
        GraycastError: the results are missing, damaged, or of another dataset.
    """
    task = Task(results=results, dataset=dataset, protocol=Protocol())
    return evaluate(task, progress=progress)[0]


def found_index(evaluation: Evaluation, stored: StoredDataset) -> dict[str, Any]:
    """The data of the grid's filters: instances to find, and scores of hits and mistakes per scene.

    Outlines are judged by masks where there are any. Detections are of pictures in `train/`,
    however these are divided.
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
        "score": 0.5 if np.isnan(point.score) else _below(point.score),
        "told": evaluation_summary(evaluation).splitlines(),
        "scenes": rows,
    }


def found_scripts(evaluation: Evaluation, stored: StoredDataset) -> Iterator[tuple[str, bytes]]:
    """Scene keys, and for each a script with its detections and what is found of its instances."""
    judgement = _judgement(evaluation)
    scenes = len(judgement.known.labels)
    detections: list[dict[int, dict[str, Any]]] = [{} for _ in range(scenes)]
    found_at: list[dict[int, float]] = [{} for _ in range(scenes)]
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
                found_at[scene][taken] = round(float(matches.score[i]), _DIGITS)
    for scene, labels in enumerate(judgement.known.labels):
        key = stored.picture(labels.scene_id).key
        instances = {
            str(_instance(judgement, scene, i)): {
                "found": found_at[scene].get(i),
                "ignored": bool(labels.ignored[i]),
            }
            for i in range(len(labels))
        }
        of_scene = [one for _, one in sorted(detections[scene].items())]
        yield key, _receiving(f"{key}/{FOUND}", of_scene, instances)


def _judgement(evaluation: Evaluation) -> Judgement:
    return evaluation.judgements[-1]  # masks come after boxes


def _below(score: float) -> float:
    """Rounded so that the detection of that score still counts on the page."""
    return float(np.floor(score * 100) / 100)


def _instance(judgement: Judgement, scene: int, place: int) -> int | None:
    """Place in `scene_gt.json`."""
    labels = judgement.known.labels[scene]
    if place < 0:
        return None
    return place if labels.instance is None else int(labels.instance[place])


def _outline(judgement: Judgement, scene: int, place: int) -> dict[str, Any]:
    found = judgement.known.found[scene]
    box = found.box_px[place]
    outline: dict[str, Any] = {"box": [round(float(edge), 1) for edge in box]}
    if judgement.kind == "mask" and found.mask is not None:
        mask: Mapping[str, Any] = found.mask[place]
        drawn = coco_mask.decode(dict(mask))
        rings, _ = cv2.findContours(drawn, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        outline["rings"] = [ring.reshape(-1).tolist() for ring in rings if len(ring) > 2]
    return outline


def _receiving(name: str, detections: list[dict[str, Any]], instances: dict[str, Any]) -> bytes:
    content = {"key": name, "detections": detections, "instances": instances}
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return f"Graycast.receive({text});\n".encode()
