"""Can a classifier tell two sets of depth maps apart? By which of their features, and where?

Squares of both sets are cut from smooth places and from the floor; a forest of randomised trees
learns to tell whose they are, and is judged by squares of maps that it has not seen. Its area under
the receiver's curve (AUC) is 0.5 where nothing tells, 1 where everything does. In the same table
stand the first set's maps against each other, which is the best that a twin can reach, and what
simulations without a sensor reach: perfect depth, bare and with Gaussian noise and drop-outs.

Source: Lopez-Paz & Oquab, "Revisiting classifier two-sample tests", ICLR 2017.
"""

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.robust import robust_sigma
from .missing import missing_among
from .patches import GROUPS, Squares, cut_squares, second_difference
from .scan import DepthScan

PLACES = ("smooth", "floor")
_TREES = 200
_LEAST_IN_LEAF = 3
_LEAST_SQUARES = 20
_FOLDS = 5
_MOST_HALVES = 6  # The first set is divided into two in at most this many ways.


@dataclass(frozen=True, slots=True, kw_only=True)
class Auc:
    """Mean and standard deviation over the folds; None where a place has too few squares."""

    mean: float | None
    spread: float | None
    squares: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Telling:
    """Separation of the two sets by one feature alone, and the feature's difference."""

    feature: str
    auc: float
    median: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSample:
    """The test's table: by row, such as 'a against b', by place and by group of features.

    `telling` has, by place, the sensor's features, the most telling first; `score` is, by place,
    how much each square of both sets looks like one of the second, by maps that were left out.
    """

    row: dict[str, dict[str, dict[str, Auc]]]
    telling: dict[str, tuple[Telling, ...]]
    squares: tuple[Squares, Squares]
    score: dict[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]]


def two_sample_test(
    first: Sequence[DepthScan],
    second: Sequence[DepthScan],
    *,
    perfect: Sequence[DepthScan] = (),
    names: tuple[str, str],
    seed: int,
    progress: ProgressMeter = UNWATCHED,
) -> TwoSample:
    """Judge the second set by the first, by squares of maps that were left out of the learning.

    Args:
        perfect: depth of the second set's scenes without a sensor, for the rows beside.
        names: of the sets, in the table.

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
    others: dict[str, Squares] = {}
    for name, scans in _naive(first, perfect, seed).items():
        progress.stage(f"cutting squares of {name}")
        others[name] = cut_squares(scans, step_m=step_m)
    row = {}
    for name, squares in {names[1]: b, "itself": None, **others}.items():
        progress.stage(f"learning {names[0]} against {name}")
        row[f"{names[0]} against {name}"] = {
            place: _against_itself(a.at(place), seed)
            if squares is None
            else {group: _auc(a.at(place), squares.at(place), group, seed) for group in GROUPS}
            for place in PLACES
        }
    return TwoSample(
        row=row,
        telling={place: _telling(a.at(place), b.at(place)) for place in PLACES},
        squares=(a, b),
        score={place: _scores(a.at(place), b.at(place), "sensor", seed)[1] for place in PLACES},
    )


def sensor_auc(first: Squares, second: Squares, place: str, *, seed: int) -> float | None:
    """Return the AUC by the sensor's features alone, of squares at one place."""
    return _auc(first.at(place), second.at(place), "sensor", seed).mean


def depth_step_m(scans: Sequence[DepthScan]) -> float:
    """Return the step in which a set's files hold depth [m]; 0 of floats.

    The least difference between the values of a map, where all differences are multiples of it.
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


# --- what is compared ----------------------------------------------------------------------------


def _naive(
    real: Sequence[DepthScan], perfect: Sequence[DepthScan], seed: int
) -> dict[str, tuple[DepthScan, ...]]:
    """Perfect depth, and perfect depth with the first set's share of noise and drop-outs."""
    if len(perfect) < 2:
        return {}
    sigma_m = float(np.median([_sigma_m(scan.depth_m) for scan in real]))
    missing = float(np.mean([missing_among(scan.valid, scan.valid) for scan in real]))
    rng = np.random.default_rng(seed)
    return {
        "perfect depth": tuple(perfect),
        "perfect depth with noise and drop-outs": tuple(
            _noisy(scan, sigma_m, missing, rng) for scan in perfect
        ),
    }


def _sigma_m(depth_m: Float[np.ndarray, "h w"]) -> float:
    mixed = second_difference(depth_m)
    return robust_sigma(mixed[~np.isnan(mixed)])


def _noisy(scan: DepthScan, sigma_m: float, missing: float, rng: np.random.Generator) -> DepthScan:
    depth_m = scan.depth_m + rng.normal(0.0, sigma_m, scan.depth_m.shape)
    depth_m[rng.random(depth_m.shape) < missing] = np.nan
    return DepthScan(name=f"{scan.name} (noisy)", depth_m=depth_m, K=scan.K.copy())


# --- learning ------------------------------------------------------------------------------------


def _auc(a: Squares, b: Squares, group: str, seed: int) -> Auc:
    counts = (len(a.scan), len(b.scan))
    if min(counts) < _LEAST_SQUARES or min(len(set(s.scan)) for s in (a, b)) < 2:
        return Auc(mean=None, spread=None, squares=counts)
    values, _ = _scores(a, b, group, seed)
    return Auc(mean=float(np.mean(values)), spread=float(np.std(values)), squares=counts)


def _against_itself(squares: Squares, seed: int) -> dict[str, Auc]:
    """Judge one half of the maps by the other, over several ways to divide them."""
    scans = sorted(set(squares.scan.tolist()))
    ways = list(combinations(scans, len(scans) // 2))
    if len(scans) % 2 == 0:
        ways = ways[: len(ways) // 2]  # the rest are the same halves, named the other way round
    order = np.random.default_rng(seed).permutation(len(ways))[:_MOST_HALVES]
    halves = [
        (squares.of_scans(ways[k]), squares.of_scans([s for s in scans if s not in ways[k]]))
        for k in order
    ]
    result = {}
    for group in GROUPS:
        aucs = [_auc(half, rest, group, seed).mean for half, rest in halves]
        means = [mean for mean in aucs if mean is not None]
        result[group] = Auc(
            mean=float(np.mean(means)) if means else None,
            spread=float(np.std(means)) if means else None,
            squares=(len(squares.scan), len(squares.scan)),
        )
    return result


def _scores(
    a: Squares, b: Squares, group: str, seed: int
) -> tuple[list[float], tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]]:
    """Return the AUC of each fold, and each square's score; NaN where nothing could be learnt."""
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.metrics import roc_auc_score

    x = np.nan_to_num(np.concatenate([a.group(group), b.group(group)]), nan=-99.0)
    y = np.repeat([0, 1], [len(a.scan), len(b.scan)])
    fold = np.concatenate([_folds(a), _folds(b)])
    score, values = np.full(len(y), np.nan), []
    for k in range(int(fold.max(initial=-1)) + 1):
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
    return values, (score[: len(a.scan)], score[len(a.scan) :])


def _folds(squares: Squares) -> np.ndarray:
    """Maps in turn, so that a fold's maps are seen whole or not at all."""
    order = {scan: k for k, scan in enumerate(sorted(set(squares.scan.tolist())))}
    folds = max(2, min(_FOLDS, len(order)))
    return np.array([order[scan] % folds for scan in squares.scan.tolist()], dtype=int)


def _telling(a: Squares, b: Squares) -> tuple[Telling, ...]:
    """Return each sensor feature's AUC: the share of pairs that it orders right, ties half."""
    from scipy.stats import rankdata

    telling = []
    for k, name in enumerate(GROUPS["sensor"]):
        first, second = (s.group("sensor")[:, k] for s in (a, b))
        first, second = first[~np.isnan(first)], second[~np.isnan(second)]
        if min(len(first), len(second)) < _LEAST_SQUARES:
            continue
        rank = rankdata(np.concatenate([first, second]))[len(first) :].sum()
        wins = rank - len(second) * (len(second) + 1) / 2
        auc = float(wins / (len(first) * len(second)))
        median = float(np.median(first)), float(np.median(second))
        telling.append(Telling(feature=name, auc=max(auc, 1 - auc), median=median))
    return tuple(sorted(telling, key=lambda one: -one.auc))
