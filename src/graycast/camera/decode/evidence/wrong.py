"""The probability that a decoded depth is wrong, from the evidence of `cues.py`.

A depth is wrong if it is off by more than `WRONG_M` and `WRONG_SIGMAS` of its sigmas. The table of
evidence, `wrong.npz`, is a sum of small decision trees, which gives the logarithm of the odds of a
wrong depth. `python -m studies.wrong_depth` makes it from simulated scenes of several scanners,
codes, parts and materials, with `sense` of each cue as a constraint: no tree may count a better fit
as evidence against a pixel. docs/measurements/wrong_depth.md has its calibration on other scenes.

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
# Commit fffd70d3 made this table with `python -m studies.wrong_depth`, from scenes in which small
# errors at edges do not count as wrong. Without a rig it is better at large errors of positions.
TABLE_WITHOUT_RIG = "wrong_without_rig.npz"


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
def evidence(name: str = TABLE) -> Evidence:
    """Return a table that is part of the package."""
    with (files(__package__) / name).open("rb") as file, np.load(file) as table:
        if tuple(table["names"]) != NAMES:
            raise RuntimeError(
                f"{name} was made for other cues: make it again with `python -m "
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
) -> tuple[CodeMap, DepthMap]:
    """Return the depth with its `p_wrong`, without the pixels for which it is too large.

    A removed pixel gets the reason whose evidence counts most against it. If that is a reason of
    the code, the pixel has no position either, as when the decoder gives it this reason.

    Args:
        depth: the depth of the positions in `codes`, before filters.
        max_p_wrong: the largest accepted probability; with 1, nothing is estimated or removed.
    """
    if max_p_wrong == 1:
        return codes, depth
    cues = cues_of(frames, code, levels, codes, depth, rig)
    p_wrong = _probability(cues, np.isfinite(depth.depth_m), evidence())
    doubtful = p_wrong > np.float32(max_p_wrong)
    depth = replace(depth, p_wrong=p_wrong)
    if not doubtful.any():
        return codes, depth
    depth = depth.without(doubtful, spoken_against(cues[:, doubtful], evidence()))
    lost = doubtful & ~np.isin(depth.reason, POSITIONED)
    return codes.without(lost, depth.reason[lost]), depth


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
    table = evidence(TABLE_WITHOUT_RIG)
    p_wrong = _probability(cues, codes.reason == Reason.DECODED, table)
    doubtful = p_wrong > np.float32(max_p_wrong)
    if not doubtful.any():
        return codes, p_wrong
    p_wrong[doubtful] = np.nan
    return codes.without(doubtful, spoken_against(cues[:, doubtful], table)), p_wrong


def _probability(
    cues: Float32[np.ndarray, "cues h w"], known: Bool[np.ndarray, "h w"], table: Evidence
) -> Float32[np.ndarray, "h w"]:
    p_wrong = np.full(known.shape, np.nan, dtype=np.float32)
    _weigh(cues, known, table, p_wrong)
    return p_wrong


def spoken_against(cues: Float32[np.ndarray, "cues n"], table: Evidence) -> UInt8[np.ndarray, " n"]:
    """Return the reason of each pixel: the kind of evidence without which it would look best.

    The cues of each reason in turn take their values at right pixels. The reason counts for which
    the probability of a wrong depth falls most.
    """
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
