"""Classifier two-sample test for two sets of depth maps.

Squares of both sets are cut from smooth surfaces and from the floor. A forest of randomised trees
learns from which set a square is, and is tested with squares of maps that it was not trained with.
The area under the ROC curve (AUC) is 0.5 if the forest cannot distinguish the sets, and 1 if it
always can. The AUC between halves of the first set is the best value that a twin can reach.

Source: Lopez-Paz & Oquab, "Revisiting classifier two-sample tests", ICLR 2017.
"""

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from .patches import Squares, cut_squares
from .scan import DepthScan

PLACES = ("smooth", "floor")
_TREES = 200
_LEAST_IN_LEAF = 3
_LEAST_SQUARES = 20
_FOLDS = 5
_MOST_HALVES = 6  # The first set is split into halves in at most this many ways.


@dataclass(frozen=True, slots=True, kw_only=True)
class Auc:
    """Mean and standard deviation of the AUC over the folds; None if there are too few squares."""

    mean: float | None
    spread: float | None
    squares: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSample:
    """The AUC between two sets, and between halves of the first set, for smooth squares and floor.

    `score` has the probability that a square is from the second set, according to a forest that was
    trained without the square's map.
    """

    names: tuple[str, str]
    auc: Mapping[str, Auc]
    itself: Mapping[str, Auc]
    squares: tuple[Squares, Squares]
    score: Mapping[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]]


def two_sample_test(
    first: Sequence[DepthScan],
    second: Sequence[DepthScan],
    *,
    names: tuple[str, str],
    seed: int,
    progress: ProgressMeter = UNWATCHED,
) -> TwoSample:
    """Compare two sets with a classifier, by cross-validation over maps.

    Args:
        names: names of the sets, for the table.

    Raises:
        GraycastError: scikit-learn is not installed, or a set has fewer than two maps.
    """
    require_sklearn()
    for scans, name in ((first, names[0]), (second, names[1])):
        if len(scans) < 2:
            raise GraycastError(
                f"{name}: has {len(scans)} depth map: give at least two, because the test leaves "
                "out each map once"
            )
    step_m = max(depth_step_m(first), depth_step_m(second))
    progress.stage(f"cutting squares of {names[0]}")
    a = cut_squares(first, step_m=step_m)
    progress.stage(f"cutting squares of {names[1]}")
    b = cut_squares(second, step_m=step_m)
    progress.stage(f"learning {names[0]} against {names[1]}")
    auc, score = {}, {}
    for place in PLACES:
        auc[place], score[place] = _auc(a.at(place), b.at(place), seed)
    progress.stage(f"learning {names[0]} against itself")
    itself = {place: _against_itself(a.at(place), seed) for place in PLACES}
    return TwoSample(names=names, auc=auc, itself=itself, squares=(a, b), score=score)


def sensor_auc(first: Squares, second: Squares, place: str, *, seed: int) -> float | None:
    """Return the AUC of a classifier for the squares of two sets at one place; None if unknown."""
    return _auc(first.at(place), second.at(place), seed)[0].mean


def depth_step_m(scans: Sequence[DepthScan]) -> float:
    """Return the step [m] of a set's quantised depth; 0 for floats.

    It is the usual difference of successive values in the first map if the others are multiples.
    """
    value = np.unique(scans[0].depth_m[scans[0].valid])
    if len(value) < 100:
        return 0.0
    gap = np.diff(value)
    step = float(np.median(gap[gap < np.quantile(gap, 0.5) * 1.5]))
    off = np.abs(gap / step - np.round(gap / step))
    return step if step > 1e-6 and np.quantile(off, 0.99) < 0.05 else 0.0


def require_sklearn() -> None:
    """Raise GraycastError if scikit-learn is not installed."""
    if importlib.util.find_spec("sklearn") is None:
        raise GraycastError(
            "the two-sample test needs scikit-learn, which is not installed: run pip install "
            "'graycast[twin]'"
        )


# --- learning ------------------------------------------------------------------------------------


def _auc(
    a: Squares, b: Squares, seed: int
) -> tuple[Auc, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]]:
    """Return the AUC and the score of each square, which is NaN if there are too few squares."""
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.metrics import roc_auc_score

    counts = (len(a.scan), len(b.scan))
    y = np.repeat([0, 1], counts)
    score, values = np.full(len(y), np.nan), []
    if min(counts) >= _LEAST_SQUARES and min(len(set(s.scan)) for s in (a, b)) >= 2:
        x = np.nan_to_num(np.concatenate([a.feature, b.feature]), nan=-99.0)
        fold = np.concatenate([_folds(a), _folds(b)])
        for k in range(fold.max() + 1):
            rest, left = fold != k, fold == k
            if min(len(set(y[rest])), len(set(y[left]))) < 2:
                continue
            forest = ExtraTreesClassifier(
                n_estimators=_TREES,
                min_samples_leaf=_LEAST_IN_LEAF,
                class_weight="balanced",
                random_state=seed,
            )
            score[left] = forest.fit(x[rest], y[rest]).predict_proba(x[left])[:, 1]
            values.append(float(roc_auc_score(y[left], score[left])))
    return _mean(values, counts), (score[: counts[0]], score[counts[0] :])


def _mean(values: Sequence[float], squares: tuple[int, int]) -> Auc:
    if not values:
        return Auc(mean=None, spread=None, squares=squares)
    return Auc(mean=float(np.mean(values)), spread=float(np.std(values)), squares=squares)


def _against_itself(squares: Squares, seed: int) -> Auc:
    """Return the mean AUC between two halves of the maps, over several divisions into halves."""
    scans = sorted(set(squares.scan.tolist()))
    ways = list(combinations(scans, len(scans) // 2))
    if len(scans) % 2 == 0:
        ways = ways[: len(ways) // 2]  # The other ways have the same halves in reverse order.
    order = np.random.default_rng(seed).permutation(len(ways))[:_MOST_HALVES]
    halves = [
        (squares.of_scans(ways[k]), squares.of_scans([s for s in scans if s not in ways[k]]))
        for k in order
    ]
    means = [_auc(half, rest, seed)[0].mean for half, rest in halves]
    return _mean([mean for mean in means if mean is not None], (len(squares.scan),) * 2)


def _folds(squares: Squares) -> np.ndarray:
    """Return the fold of each square; all squares of a map are in one fold."""
    order = {scan: k for k, scan in enumerate(sorted(set(squares.scan.tolist())))}
    folds = max(2, min(_FOLDS, len(order)))
    return np.array([order[scan] % folds for scan in squares.scan.tolist()], dtype=int)
