"""Precision over recall of matched detections, also for bootstrap resamples of the scenes.

A scene that is drawn twice counts twice: as two scenes with the same content. Where detections have
equal scores, those of one scene come first and then those of the next, as for the scenes
themselves. If each detection stood beside its own copies instead, runs of hits and of mistakes
would be longer in draws than in the data, and with them average precision would be higher.

Hits raise precision and recall together, mistakes lower precision alone, and the curve that COCO
takes is the highest precision at a recall or above.
"""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int

from .matching import ClassMatches

RECALLS = np.linspace(0.0, 1.0, 101)  # They are COCO's.
RECALLS.flags.writeable = False


def precision_curves(matches: ClassMatches) -> Float[np.ndarray, "t recalls"]:
    """Highest precision at each of `RECALLS` or above, for each threshold; NaN if none to find."""
    curves = np.full((len(matches.hit), len(RECALLS)), np.nan)
    if wanted := int(matches.to_find.sum()):
        times = np.ones(len(matches.scene), dtype=np.int64)
        for t, curve in enumerate(curves):
            _curve(
                matches.hit[t], matches.counted[t], _runs(matches), times, wanted, RECALLS, curve
            )
    return curves


def _runs(matches: ClassMatches) -> Int[np.ndarray, " runs"]:
    """Where detections of one scene with one score begin, and the end of the last."""
    if not len(matches.score):
        return np.zeros(1, dtype=np.int64)
    new = (np.diff(matches.score) != 0) | (np.diff(matches.scene) != 0)
    return np.concatenate([[0], 1 + np.flatnonzero(new), [len(new) + 1]])


def class_figures(
    matches: ClassMatches, times: Int[np.ndarray, "draws scenes"]
) -> tuple[Float[np.ndarray, "draws t"], Float[np.ndarray, "draws t"]]:
    """Average precision and recall of a class at each threshold.

    Args:
        times: how often each scene counts in each draw.

    Returns:
        (average precision, recall of all detections); NaN where a draw has nothing to find.
    """
    scene, to_find, runs = matches.scene, matches.to_find, _runs(matches)
    often = times.astype(np.int64, order="C")
    return _figures(matches.hit, matches.counted, scene, runs, to_find, often, RECALLS)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker would wrap the function, which numba cannot compile
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


@numba.njit(cache=True)
@no_type_check  # the tests' type checker would wrap the function, which numba cannot compile
def _curve(hit, counted, runs, times, wanted, recalls, curve):
    """Fill `curve`; returns the recall of all detections. Precision matters at hits alone."""
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
