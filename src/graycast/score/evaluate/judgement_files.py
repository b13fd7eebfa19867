"""The files of an evaluation: figures as JSON, CSV and Markdown, plots, and sheets of mistakes."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.public_value import public_value
from ...base.tables import csv_text, markdown_table
from ...dataset.files.json_text import plain
from .intervals import Interval
from .judgement_plots import (
    Picture,
    draw_false_alarms,
    draw_groups,
    draw_misses,
    draw_precision_recall,
)
from .judging import Judgement, Protocol
from .matching import THRESHOLDS
from .mistakes import AT_HALF
from .results import DetectionRun
from .scores import FIGURES

EVALUATION = "evaluation.json"
_TITLES = {"ap": "AP", "ap50": "AP50", "ap75": "AP75", "ar": "AR"}


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """An evaluation of one file of detections: the data, the protocol and the results."""

    dataset: str
    split: str
    run: DetectionRun
    against: DetectionRun | None
    categories: Mapping[int, str]
    protocol: Protocol
    judgements: tuple[Judgement, ...]
    notes: tuple[str, ...]  # warnings about the results


def write_evaluation(evaluation: Evaluation, picture: Picture, folder: Path) -> None:
    """Write the evaluation's files; a kind of mistake that does not occur gets no sheet.

    Args:
        picture: function that returns a scene's picture by its id.

    Raises:
        GraycastError: the folder cannot be written.
    """
    text = json.dumps(evaluation_json(evaluation), indent=1, allow_nan=False)
    (folder / EVALUATION).write_text(text + "\n", encoding="utf-8")
    (folder / "figures.csv").write_text(_csv(evaluation), encoding="utf-8")
    (folder / "figures.md").write_text(
        "\n\n".join(_paragraphs(evaluation)) + "\n", encoding="utf-8"
    )
    judgements = evaluation.judgements
    draw_precision_recall(judgements, evaluation.categories, folder / "precision_recall.png")
    draw_groups(judgements, folder / "groups.png")
    for judgement in judgements:
        draw_misses(judgement, picture, folder / f"misses_{judgement.kind}.png")
        draw_false_alarms(judgement, picture, folder / f"false_alarms_{judgement.kind}.png")


def evaluation_json(evaluation: Evaluation) -> dict[str, Any]:
    """Return all figures as values for JSON, with None instead of NaN."""
    protocol, run, known = evaluation.protocol, evaluation.run, evaluation.judgements[0].known
    return plain(
        {
            "dataset": evaluation.dataset,
            "split": evaluation.split,
            "results": run.name,
            "model": run.model,
            "input": run.input,
            "against": None if evaluation.against is None else evaluation.against.name,
            "median_ms_per_picture": run.median_ms,
            "scene_ids": [one.scene_id for one in known.labels],
            "instances": sum(map(len, known.labels)),
            "ignored": sum(int(one.ignored.sum()) for one in known.labels),
            "detections": sum(map(len, known.detections)),
            "protocol": {
                "thresholds": THRESHOLDS.round(2),
                "min_visibility": protocol.min_visibility,
                "most_detections": protocol.most,
                "draws": protocol.draws,
                "seed": protocol.seed,
            },
            "notes": list(evaluation.notes),
            "kinds": {one.kind: _judgement_json(one) for one in evaluation.judgements},
        }
    )


def summary(evaluation: Evaluation) -> str:
    """Return the figures over all instances as text for the terminal."""
    lines = [_what(evaluation)]
    for one in evaluation.judgements:
        lines.append(f"{one.kind:5} {_sentence(one.rows[0].figures)}")
        if one.against is not None:
            lines.append(f"      difference: {_sentence(one.against, '+.3f')}")
        lines.append(f"      {_point(one)}")
    lines += [f"note: {note}" for note in evaluation.notes]
    return "\n".join(lines)


def _paragraphs(evaluation: Evaluation) -> Iterator[str]:
    """Yield the paragraphs of the Markdown file: text, and tables of scores with intervals."""
    yield "# " + evaluation.run.name
    yield _what(evaluation)
    yield from evaluation.notes
    for one in evaluation.judgements:
        yield f"## {one.kind.capitalize()}"
        yield _point(one)
        yield _mistakes(one)
        yield _table(one)
        if one.against is not None and evaluation.against is not None:
            yield (
                f"Difference from the results of {evaluation.against.name}, on the same draws of "
                "scenes:"
            )
            yield markdown_table(list(_TITLES.values()), [_texts(one.against, "+.3f")])


def _sentence(figures: Mapping[str, Interval], form: str = ".3f") -> str:
    pairs = zip(_TITLES.values(), _texts(figures, form), strict=True)
    return ", ".join(" ".join(pair) for pair in pairs)


def _what(evaluation: Evaluation) -> str:
    known, run = evaluation.judgements[0].known, evaluation.run
    empty = sum(not len(one) for one in known.detections)
    instances = sum(map(len, known.labels))
    ignored = sum(int(one.ignored.sum()) for one in known.labels)
    source = "" if run.model is None else f" of {run.model} on {run.input}"
    speed = "" if np.isnan(run.median_ms) else f" {run.median_ms:.0f} ms a picture (median)."
    return (
        f"{sum(map(len, known.detections))} detections{source} in {len(known.labels)} scenes of "
        f"{evaluation.dataset} (set {evaluation.split}; nothing was found in {empty}), "
        f"{instances - ignored} instances to find; {ignored} of less than "
        f"{evaluation.protocol.min_visibility:.0%} visibility are ignored.{speed}"
    )


def _point(one: Judgement) -> str:
    if np.isnan(one.point.score):
        return "Nothing was found, so there is no recommended threshold on the score."
    return (
        f"From a score of {one.point.score:.2f} on (best F1 at an overlap of 0.5): "
        f"{one.point.recall:.1%} are found, {one.point.precision:.1%} of the detections are right."
    )


def _mistakes(one: Judgement) -> str:
    why = Counter(alarm.why for alarm in one.false_alarms)
    counts = ", ".join(f"{count} {name}" for name, count in why.most_common())
    return (
        f"There {len(one.misses)} are missed, {len(one.false_alarms)} alarms are false"
        f"{f' ({counts})' if counts else ''}."
    )


def _table(one: Judgement) -> str:
    heads = ["by", "which", "to find", *(_TITLES[name] for name in FIGURES)]
    rows = [[row.by, row.name, str(row.to_find), *_texts(row.figures)] for row in one.rows]
    return markdown_table(heads, rows)


def _texts(figures: Mapping[str, Interval], form: str = ".3f") -> list[str]:
    return [figures[name].text(form, none="none to find") for name in FIGURES]


def _judgement_json(one: Judgement) -> dict[str, Any]:
    return {
        "figures": [
            {"by": row.by, "name": row.name, "to_find": row.to_find, **_intervals(row.figures)}
            for row in one.rows
        ],
        "difference": None if one.against is None else _intervals(one.against),
        "working_point": {
            **asdict(one.point),
            "missed": len(one.misses),
            "false_alarms": dict(Counter(alarm.why for alarm in one.false_alarms)),
        },
        "scenes": list(_scenes(one)),
    }


def _intervals(figures: Mapping[str, Interval]) -> dict[str, Any]:
    return {name: asdict(figure) for name, figure in figures.items()}


def _scenes(one: Judgement) -> Iterator[dict[str, Any]]:
    """Yield the numbers of hits, misses and false alarms of each scene at the working point."""
    hits: Counter[int] = Counter()
    for match in one.scores.matches.values():
        at_work = match.hit[AT_HALF] & (match.score >= one.point.score)
        hits.update(match.scene[at_work].tolist())
    missed = Counter(miss.scene for miss in one.misses)
    false = Counter(alarm.scene for alarm in one.false_alarms)
    for scene, labels in enumerate(one.known.labels):
        yield {
            "scene_id": labels.scene_id,
            "found": hits[scene],
            "missed": missed[scene],
            "false": false[scene],
        }


def _csv(evaluation: Evaluation) -> str:
    rows: list[list[object]] = []
    for one in evaluation.judgements:
        for row in one.rows:
            head = [one.kind, row.by, row.name, row.to_find]
            rows += [[*head, name, *f.cells()] for name, f in row.figures.items()]
        head = [one.kind, "difference", "all", one.rows[0].to_find]
        rows += [[*head, name, *f.cells()] for name, f in (one.against or {}).items()]
    return csv_text(["kind", "by", "name", "to_find", "figure", "value", "low", "high"], rows)
