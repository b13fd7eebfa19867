"""What a reader of the figures must know of the results: equal scores, and doubled entries."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...dataset.detections import Detections
from .curves import precision_curves
from .judging import Judgement
from .matching import ClassMatches

TELLING = 0.005  # A note is worth it if the order of equal scores moves AP by this at least.


def notes(judgements: Sequence[Judgement]) -> Iterator[str]:
    """Sentences about one file of results."""
    if doubled := sum(map(_doubled, judgements[0].known.detections)):
        yield (
            f"{doubled} detections repeat another one (same picture, class and outline), and each "
            "counts as a false alarm: remove them from the results."
        )
    for one in judgements:
        low, high = ap_of_any_order(one.scores.matches)
        if high - low < TELLING:
            continue
        score = np.concatenate([each.score for each in one.scores.matches.values()])
        equal = "all scores are equal" if len(set(score.tolist())) == 1 else "scores are equal"
        yield (
            f"{one.kind}: {equal}, so that AP depends on the order of the detections in the file: "
            f"it is {one.scores.ap:.3f}, and another order could make it {low:.3f} to {high:.3f}."
        )


def ap_of_any_order(matches: Mapping[int, ClassMatches]) -> tuple[float, float]:
    """AP if among equal scores all mistakes came first, and if all hits did.

    The matches stay the same: within a picture, another order could also change them.
    """
    worst, best = (
        [float(precision_curves(_sorted(one, sign)).mean()) for one in matches.values()]
        for sign in (1, -1)
    )
    known = ~np.isnan(worst)
    if not known.any():
        return float("nan"), float("nan")
    return float(np.mean(np.array(worst)[known])), float(np.mean(np.array(best)[known]))


def _sorted(one: ClassMatches, sign: int) -> ClassMatches:
    """Hits after mistakes of the same score (sign 1), or before them."""
    order = np.stack([np.lexsort((sign * hit, -one.score)) for hit in one.hit.astype(int)])
    return replace(
        one,
        hit=np.take_along_axis(one.hit, order, axis=1),
        counted=np.take_along_axis(one.counted, order, axis=1),
    )


def _doubled(detections: Detections) -> int:
    """How many detections of a picture have the class, box and mask of an earlier one."""
    masks = (
        [None] * len(detections)
        if detections.mask is None
        else [str(m["counts"]) for m in detections.mask]
    )
    outlines = zip(
        detections.obj_id.tolist(), map(tuple, detections.box_px.tolist()), masks, strict=True
    )
    return sum(count - 1 for count in Counter(outlines).values())
