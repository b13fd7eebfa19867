"""The probability that a decoded depth is wrong, from the evidence of `cues.py`.

A depth is wrong if it is off by more than `WRONG_M` and `WRONG_SIGMAS` of its sigmas. The table of
evidence, `wrong.npz`, is a sum of small decision trees, which gives the logarithm of the odds of a
wrong depth. `python -m studies.wrong_depth` makes it from simulated scenes of several scanners,
codes, parts and materials, with `sense` of each cue as a constraint: no tree may count a better fit
as evidence against a pixel. docs/measurements/wrong_depth.md has its calibration on other scenes.
In moving scenes, the correlation of the pictures that were taken back changes these odds.

Source: J. Friedman, "Greedy Function Approximation: A Gradient Boosting Machine", 2001.
"""

from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Bool, Float32, Int16, Int32, UInt8, UInt16

from ....base.kernels import kernel
from ....rig.pair import Rig
from ....rig.pattern import Code
from ..maps import CodeMap, DepthMap, Levels
from ..reasons import POSITIONED, Reason
from .cues import CUES, NAMES, cues_of

TABLE = "wrong.npz"
# If a point moved in the picture, and its pictures have the correlation r with the light of its
# depth, then P(r | wrong) / P(r | right) = RATIO (1 - r)^POWER, which is 1 at r = 0.954. It comes
# from moving scenes (`python -m studies.moving_evidence`).
RATIO, POWER = 7.0, 0.63


class Evidence(NamedTuple):
    """Decision trees, one node after the other.

    A pixel goes from a node to the node `next` if its cue is at most `limit`, or if the cue is NaN
    and `lacking` is true; else to the node after `next`. A leaf has the cue -1, and its `limit` is
    the logarithm of odds that it adds. `start` has the first node of each tree, `typical` the
    median of each cue where depth is right.
    """

    start: Int32[np.ndarray, " trees"]
    cue: Int16[np.ndarray, " nodes"]
    limit: Float32[np.ndarray, " nodes"]
    lacking: Bool[np.ndarray, " nodes"]
    next: Int32[np.ndarray, " nodes"]
    typical: Float32[np.ndarray, " cues"]


@cache
def evidence() -> Evidence:
    """Return the table that is part of the package."""
    with (files(__package__) / TABLE).open("rb") as file, np.load(file) as table:
        if tuple(table["names"]) != NAMES:
            raise RuntimeError(
                f"{TABLE} was made for other cues: make it again with `python -m "
                "studies.wrong_depth`"
            )
        return Evidence(*(table[name] for name in Evidence._fields))


def without_doubt(
    codes: CodeMap,
    depth: DepthMap,
    rig: Rig,
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    levels: Levels,
    *,
    max_p_wrong: float,
    correlation: Float32[np.ndarray, "h w"] | None = None,
) -> tuple[CodeMap, DepthMap]:
    """Return the depth with its `p_wrong`, without the pixels for which it is too large.

    A removed pixel gets the reason whose evidence counts most against it. If that is a reason of
    the code, the pixel has no position either, as when the decoder gives it this reason.

    Args:
        depth: the depth of the positions in `codes`, before filters.
        max_p_wrong: the largest accepted probability; with 1, nothing is estimated or removed.
        correlation: that of `TakenBack`, which is evidence too; None: nothing was taken back.
    """
    if max_p_wrong == 1:
        return codes, depth
    evidence_of = rig, frames, code, levels
    if correlation is not None and np.isfinite(correlation).any():
        # Wrong neighbours support wrong depth, and moving scenes have many. So the evidence of the
        # other pixels is computed once more without the doubtful ones.
        codes, depth = _less_doubtful(codes, depth, *evidence_of, max_p_wrong, correlation)
    return _less_doubtful(codes, depth, *evidence_of, max_p_wrong, correlation)


def _less_doubtful(codes, depth, rig, frames, code, levels, max_p_wrong, correlation):
    """Return what `without_doubt` returns, from the evidence of the pixels that have depth."""
    cues = cues_of(frames, code, levels, codes, depth, rig)
    p_wrong = at_rest = _probability(cues, np.isfinite(depth.depth_m))
    if correlation is not None:
        p_wrong = with_correlation(at_rest, correlation)
    limit = np.float32(max_p_wrong)
    doubtful = p_wrong > limit
    depth = replace(depth, p_wrong=p_wrong)
    if not doubtful.any():
        return codes, depth
    reasons = spoken_against(cues[:, doubtful])
    reasons[at_rest[doubtful] <= limit] = Reason.CONTRADICTORY
    depth = depth.without(doubtful, reasons)
    lost = doubtful & ~np.isin(depth.reason, POSITIONED)
    return codes.without(lost, depth.reason[lost]), depth


def with_correlation(
    p_wrong: Float32[np.ndarray, "*pixels"], correlation: Float32[np.ndarray, "*pixels"]
) -> Float32[np.ndarray, "*pixels"]:
    """Return probabilities of wrong depth by Bayes' rule; as they are where it is NaN."""
    ratio = np.float32(RATIO) * np.maximum(1 - correlation, np.float32(1e-5)) ** np.float32(POWER)
    wrong = p_wrong * np.where(np.isnan(ratio), np.float32(1), ratio)
    return wrong / (1 - p_wrong + wrong)


def without_doubtful_positions(
    codes: CodeMap,
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    levels: Levels,
    *,
    max_p_wrong: float,
) -> tuple[CodeMap, Float32[np.ndarray, "h w"] | None]:
    """Return the positions without the doubtful ones, and the probability that each is wrong.

    This is `without_doubt` for a stack without a rig, which cannot give the evidence of epipolar
    lines and mirrors. A position counts as wrong if its depth would be wrong in rigs like those of
    the table. The probability is NaN without a position; it is None if nothing is estimated.
    """
    if max_p_wrong == 1:
        return codes, None
    cues = cues_of(frames, code, levels, codes, None, None)
    p_wrong = _probability(cues, codes.reason == Reason.DECODED)
    doubtful = p_wrong > np.float32(max_p_wrong)
    if not doubtful.any():
        return codes, p_wrong
    p_wrong[doubtful] = np.nan
    return codes.without(doubtful, spoken_against(cues[:, doubtful])), p_wrong


def _probability(
    cues: Float32[np.ndarray, "cues h w"], known: Bool[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    p_wrong = np.full(known.shape, np.nan, dtype=np.float32)
    _weigh(cues, known, evidence(), p_wrong)
    return p_wrong


def spoken_against(
    cues: Float32[np.ndarray, "cues n"],
) -> UInt8[np.ndarray, " n"]:
    """Return the reason of each pixel: the kind of evidence without which it would look best.

    The cues of each reason in turn take their values at right pixels. The reason counts for which
    the probability of a wrong depth falls most.
    """
    table = evidence()
    reasons = list(dict.fromkeys(cue.reason for cue in CUES))
    known = np.ones((1, cues.shape[1]), dtype=np.bool_)
    left = np.empty((len(reasons), cues.shape[1]), dtype=np.float32)
    for k, reason in enumerate(reasons):
        usual = cues.copy()
        for j, cue in enumerate(CUES):
            if cue.reason == reason:
                usual[j] = np.where(np.isnan(cues[j]), np.nan, table.typical[j])
        _weigh(usual[:, None], known, table, left[k : k + 1])
    return np.array(reasons, dtype=np.uint8)[left.argmin(axis=0)]


@kernel(parallel=True, error_model="numpy")
def _weigh(cues, known, table, p_wrong):
    cue, limit, lacking, after = table.cue, table.limit, table.lacking, table.next
    h, w = p_wrong.shape
    for y in numba.prange(h):
        own = np.empty(len(cues), np.float32)
        for x in range(w):
            if not known[y, x]:
                continue
            for j in range(len(own)):
                own[j] = cues[j, y, x]
            log_odds = np.float32(0)
            for first in table.start:
                node = first
                while cue[node] >= 0:
                    value = own[cue[node]]
                    missing = np.isnan(value) and not lacking[node]
                    node = after[node] + np.int32(missing or value > limit[node])
                log_odds += limit[node]
            p_wrong[y, x] = np.float32(1) / (np.float32(1) + np.exp(-log_odds))
