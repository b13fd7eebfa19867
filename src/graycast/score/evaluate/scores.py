"""Average precision and recall, as COCO defines them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...dataset.detections import Detections
from .curves import class_figures
from .labels import Labels
from .matching import THRESHOLDS, ClassMatches, Kind, Overlaps, match, overlaps

MOST = 300  # A full bin has 255 parts of a class in a scene: COCO's 100 detections are too few.
FIGURES = ("ap", "ap50", "ap75", "ar")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """The scores of detections; NaN if there is nothing to find.

    Attributes:
        ap: average precision, the mean over thresholds of 0.50 to 0.95 and over the classes.
        ap50: at a threshold of 0.50; `ap75` at 0.75.
        ar: share of the instances that are found, the mean over the same.
        scene_ids: of the pictures, in the order that `matches` has them.
        scene_of: the scene that each of them is of; several views of a scene share one.
        matches: of each class, what intervals and pictures of mistakes need.
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
        """Instances that were to be found, of all classes."""
        return int(sum(one.to_find.sum() for one in self.matches.values()))


def score(
    labels: Sequence[Labels], detections: Sequence[Detections], *, kind: Kind, most: int = MOST
) -> Scores:
    """Judge the detections of some scenes by their labels.

    Args:
        labels: of each scene once, in any order.
        detections: of the same scenes, also where nothing was found.
        kind: whether boxes or masks are compared.
        most: how many detections of a scene and a class count, best first.

    Raises:
        GraycastError: labels and detections are of different scenes or of pictures of different
            sizes, or one of them has no masks to compare.
    """
    known = overlaps(labels, detections, kind=kind, most=most)
    return scores_of(match(known), known)


def scores_of(matches: Mapping[int, ClassMatches], known: Overlaps) -> Scores:
    """The figures of matched detections."""
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
    """`FIGURES` of each draw of scenes: means over the classes that it has to find."""
    if not matches:
        return {name: np.full(len(times), np.nan) for name in FIGURES}
    both = [class_figures(one, times) for one in matches.values()]
    precision = _mean_of_known(np.array([one[0] for one in both]))
    recall = _mean_of_known(np.array([one[1] for one in both]))
    at = {round(float(value), 2): t for t, value in enumerate(THRESHOLDS)}
    return {
        "ap": precision.mean(axis=1),
        "ap50": precision[:, at[0.5]],
        "ap75": precision[:, at[0.75]],
        "ar": recall.mean(axis=1),
    }


def _mean_of_known(value: Float[np.ndarray, "classes draws t"]) -> Float[np.ndarray, "draws t"]:
    known = ~np.isnan(value)
    count = known.sum(axis=0)
    total = np.where(known, value, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
