"""Precision over recall of matched detections, also for bootstrap resamples of the scenes.

A scene that is drawn twice counts twice. Its detections stand beside their copies in the order of
scores, so counting each as often as its scene was drawn gives the same curve as copies would: hits
raise precision and recall together, mistakes lower precision alone, and the curve that COCO takes
is the highest precision at a recall or above.
"""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int

from .matching import ClassMatches

RECALLS = np.linspace(0.0, 1.0, 101)  # COCO's
RECALLS.flags.writeable = False


def precision_curves(matches: ClassMatches) -> Float[np.ndarray, "t recalls"]:
    """Highest precision at each of `RECALLS` or above, for each threshold; NaN if none to find."""
    curves = np.full((len(matches.hit), len(RECALLS)), np.nan)
    if wanted := int(matches.to_find.sum()):
        times = np.ones(len(matches.scene), dtype=np.int64)
        for t, curve in enumerate(curves):
            _curve(matches.hit[t], matches.counted[t], times, wanted, RECALLS, curve)
    return curves


def drawn_figures(
    matches: ClassMatches, times: Int[np.ndarray, "draws scenes"]
) -> tuple[Float[np.ndarray, "draws t"], Float[np.ndarray, "draws t"]]:
    """Average precision and recall of a class at each threshold.

    Args:
        times: how often each scene counts in each draw.

    Returns:
        (average precision, recall of all detections); NaN where a draw has nothing to find.
    """
    scene, to_find = matches.scene, matches.to_find
    often = times.astype(np.int64, order="C")
    return _figures(matches.hit, matches.counted, scene, to_find, often, RECALLS)


@numba.njit(cache=True)
@no_type_check  # the tests' type checker would wrap the function, which numba cannot compile
def _figures(hit, counted, scene, to_find, times, recalls):
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
            recall[b, t] = _curve(hit[t], counted[t], each, wanted, recalls, curve)
            precision[b, t] = curve.mean()
    return precision, recall


@numba.njit(cache=True)
@no_type_check  # the tests' type checker would wrap the function, which numba cannot compile
def _curve(hit, counted, times, wanted, recalls, curve):
    """Fill `curve`; returns the recall of all detections. Precision matters at hits alone."""
    hits, mistakes, steps = 0, 0, 0
    at_recall, at_precision = np.empty(len(hit)), np.empty(len(hit))
    for i in range(len(hit)):
        if not counted[i] or times[i] == 0:
            continue
        if hit[i]:
            hits += times[i]
            at_recall[steps] = hits / wanted
            at_precision[steps] = hits / (hits + mistakes)
            steps += 1
        else:
            mistakes += times[i]
    highest, step = 0.0, steps - 1
    for r in range(len(recalls) - 1, -1, -1):
        while step >= 0 and at_recall[step] >= recalls[r]:
            highest = max(highest, at_precision[step])
            step -= 1
        curve[r] = highest
    return hits / wanted
