"""Average precision and recall as defined by COCO, also for bootstrap resamples of the scenes.

A scene that is drawn twice counts as two scenes with the same content. Detections with equal scores
are in the order of their scenes, and the copies of a scene follow each other. If the copies of a
detection were adjacent instead, draws would have longer runs of hits and of mistakes than the data,
which would raise average precision.

A hit raises precision and recall; a mistake lowers only precision. COCO's curve is the highest
precision at each recall or at any larger recall.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...base.kernels import kernel
from ...base.public_value import public_value
from ...dataset.read.detections import Detections
from .labels import Labels
from .matching import ClassMatches, Kind, Overlaps, match, overlaps

MOST = 300  # COCO's 100 detections per scene are too few: a full bin has 255 parts of a class.
_AT_50, _AT_75 = 0, 5  # indices of 0.50 and 0.75 in `THRESHOLDS`
RECALLS = np.linspace(0.0, 1.0, 101)  # as in COCO
RECALLS.flags.writeable = False
FIGURES = ("ap", "ap50", "ap75", "ar")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """The scores of detections; each score is NaN if there is nothing to find.

    Attributes:
        ap: average precision, the mean over thresholds from 0.50 to 0.95 and over the classes.
        ap50, ap75: average precision at thresholds of 0.50 and 0.75, the mean over the classes.
        ar: recall (share of instances found), the mean over the same thresholds and classes.
        scene_ids: ids of the pictures, in the order of `matches`.
        scene_of: scene of each picture; several views of a scene have the same number.
        matches: matches of each class, from which intervals and mistakes are computed.
    """

    ap: float
    ap50: float
    ap75: float
    ar: float
    scene_ids: tuple[int, ...]
    scene_of: tuple[int, ...]
    matches: Mapping[int, ClassMatches]

    @property
    def scenes(self) -> int:
        return len(set(self.scene_of))

    @property
    def to_find(self) -> int:
        """Number of instances to find in all classes."""
        return int(sum(one.to_find.sum() for one in self.matches.values()))


def score(
    labels: Sequence[Labels], detections: Sequence[Detections], *, kind: Kind, most: int = MOST
) -> Scores:
    """Return the scores of detections in some scenes.

    Args:
        labels: labels of each scene, in any order.
        detections: detections in each of these scenes, including scenes without detections.
        kind: `box` or `mask`, the outlines to compare.
        most: largest number of detections of a class in a scene that count, by descending score.

    Raises:
        GraycastError: labels and detections have different scenes or different picture sizes, or
            masks are missing in one of them.
    """
    known = overlaps(labels, detections, kind=kind, most=most)
    return scores_of(match(known), known)


def scores_of(matches: Mapping[int, ClassMatches], known: Overlaps) -> Scores:
    """Return the scores of matched detections."""
    once = np.ones((1, len(known.labels)), dtype=np.int64)
    figures = {name: float(value[0]) for name, value in figures_of_draws(matches, once).items()}
    return Scores(
        scene_ids=tuple(one.scene_id for one in known.labels),
        scene_of=tuple(one.scene for one in known.labels),
        matches=matches,
        **figures,
    )


def figures_of_draws(
    matches: Mapping[int, ClassMatches], times: Int[np.ndarray, "draws scenes"]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Return `FIGURES` for each draw of scenes: means over the classes with instances to find."""
    if not matches:
        return {name: np.full(len(times), np.nan) for name in FIGURES}
    both = [class_figures(one, times) for one in matches.values()]
    precision = _mean_of_known(np.array([one[0] for one in both]))
    recall = _mean_of_known(np.array([one[1] for one in both]))
    return {
        "ap": precision.mean(axis=1),
        "ap50": precision[:, _AT_50],
        "ap75": precision[:, _AT_75],
        "ar": recall.mean(axis=1),
    }


def _mean_of_known(value: Float[np.ndarray, "classes draws t"]) -> Float[np.ndarray, "draws t"]:
    known = ~np.isnan(value)
    count = known.sum(axis=0)
    total = np.where(known, value, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


# --- precision over recall ----------------------------------------------------------------------


def precision_curves(matches: ClassMatches) -> Float[np.ndarray, "t recalls"]:
    """Return the highest precision at each of `RECALLS` or above; NaN if nothing is to be found."""
    curves = np.full((len(matches.hit), len(RECALLS)), np.nan)
    if wanted := int(matches.to_find.sum()):
        times = np.ones(len(matches.scene), dtype=np.int64)
        for t, curve in enumerate(curves):
            _curve(
                matches.hit[t], matches.counted[t], _runs(matches), times, wanted, RECALLS, curve
            )
    return curves


def _runs(matches: ClassMatches) -> Int[np.ndarray, " runs"]:
    """Return the start of each run of detections with equal scene and score, and the last end."""
    if not len(matches.score):
        return np.zeros(1, dtype=np.int64)
    new = (np.diff(matches.score) != 0) | (np.diff(matches.scene) != 0)
    return np.concatenate([[0], 1 + np.flatnonzero(new), [len(new) + 1]])


def class_figures(
    matches: ClassMatches, times: Int[np.ndarray, "draws scenes"]
) -> tuple[Float[np.ndarray, "draws t"], Float[np.ndarray, "draws t"]]:
    """Return average precision and recall of a class for each draw and threshold.

    Args:
        times: number of times that each scene counts in each draw.

    Returns:
        Average precision, and recall of all detections; NaN for draws without instances to find.
    """
    scene, to_find, runs = matches.scene, matches.to_find, _runs(matches)
    often = times.astype(np.int64, order="C")
    return _figures(matches.hit, matches.counted, scene, runs, to_find, often, RECALLS)


@kernel()
def _figures(hit, counted, scene, runs, to_find, times, recalls):
    draws, thresholds = len(times), len(hit)
    precision = np.full((draws, thresholds), np.nan)
    recall = np.full((draws, thresholds), np.nan)
    curve = np.empty(len(recalls))
    for b in range(draws):
        wanted = (times[b] * to_find).sum()
        if wanted == 0:
            continue
        each = times[b][scene]
        for t in range(thresholds):
            recall[b, t] = _curve(hit[t], counted[t], runs, each, wanted, recalls, curve)
            precision[b, t] = curve.mean()
    return precision, recall


@kernel()
def _curve(hit, counted, runs, times, wanted, recalls, curve):
    """Fill `curve` with the highest precision at each recall or above; return the final recall."""
    hits, mistakes, steps = 0, 0, 0
    most = times.sum()
    at_recall, at_precision = np.empty(most), np.empty(most)
    for run in range(len(runs) - 1):
        first, end = runs[run], runs[run + 1]
        for _ in range(times[first]):
            for i in range(first, end):
                if not counted[i]:
                    continue
                if hit[i]:
                    hits += 1
                    at_recall[steps] = hits / wanted
                    at_precision[steps] = hits / (hits + mistakes)
                    steps += 1
                else:
                    mistakes += 1
    highest, step = 0.0, steps - 1
    for r in range(len(recalls) - 1, -1, -1):
        while step >= 0 and at_recall[step] >= recalls[r]:
            highest = max(highest, at_precision[step])
            step -= 1
        curve[r] = highest
    return hits / wanted
