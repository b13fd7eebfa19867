"""Fuse the views of a scene into one cloud with one point for each place on the surface.

Each point is projected into every other view. At that pixel, the other view measured the same
surface (the views agree), a surface in front of the point (which hides it), a surface behind the
point (the view saw through it), or nothing. Measurements that agree are averaged along the normal,
weighted by their inverse variances, so N equal views reduce sigma to sigma / sqrt(N). If the
probability that a depth is wrong is known, its weight is also multiplied by 1 - p_wrong.
docs/explanation/merging.md has the equations.

Leaves out: errors that views share (from calibration, or from interreflections), which do not
average out and are not in sigma; errors of the views' poses, which are checked but not corrected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from .looking import ViewAgreement, look
from .view import MeasuredView, Points, points_of
from .view_poses import pose_doubts

# Numbers in addition to the dataset's reasons, for places without a point in the first view: it
# measured something behind the place or in front of it, or the place is outside its picture.
THROUGH, HIDDEN, OUTSIDE = 253, 254, 255
MOST = 250  # largest number of views in a merge, because view numbers have eight bits


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FusedCloud:
    """Points of a scene in the world frame, in the order of their views and pixels.

    Attributes:
        normal: surface normal towards the camera of `view`; the direction to it without a plane.
        sigma_m: standard deviation along the normal, if no averaged measurement is wrong.
        view: index of the view from which the point comes.
        pixel: row and column of the point in that view.
        views: number of views that measured the place, including `view`.
        against: number of views that saw through the point; at most as many as confirm it.
        first_reason: reason why the first view has no point there: the number of a reason, or
            THROUGH, HIDDEN or OUTSIDE; 0 if the first view has a point.
    """

    point_m: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    color: UInt8[np.ndarray, "n 3"]
    sigma_m: Float[np.ndarray, " n"]
    view: UInt8[np.ndarray, " n"]
    pixel: Int[np.ndarray, "n 2"]
    views: UInt8[np.ndarray, " n"]
    against: UInt8[np.ndarray, " n"]
    first_reason: UInt8[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Fused:
    """A fused cloud, with counts of the measured, confirmed and rejected pixels of each view.

    `doubts` are sentences about views that contradict other views; see `pose_doubts`.
    """

    cloud: FusedCloud
    doubts: tuple[str, ...]
    measured_px: tuple[int, ...]
    confirmed_px: tuple[int, ...]  # pixels that another view confirms
    rejected_px: tuple[int, ...]  # pixels that more views see through than confirm


def fuse(views: Sequence[MeasuredView]) -> Fused:
    """Fuse all views into one cloud; each place has a point from the view with the finest pixels.

    Raises:
        ValueError: there is no view, or there are more than `MOST`.
    """
    if not 1 <= len(views) <= MOST:
        raise ValueError(f"there are {len(views)} views to merge: give 1 to {MOST}")
    points = [points_of(view) for view in views]
    own = [each.at(np.argwhere(each.known)) for each in points]
    agreement = [
        {j: look(own[i], views[j], points[j]) for j in range(len(views)) if j != i}
        for i in range(len(views))
    ]
    votes = [_votes(answers, len(one.pixel)) for answers, one in zip(agreement, own, strict=True)]
    rejected = [against > confirmed for confirmed, against in votes]
    wrong = [_picture(v, one, bad) for v, one, bad in zip(views, own, rejected, strict=True)]
    pieces = [
        _piece(
            i,
            own[i],
            agreement[i],
            views,
            votes[i],
            ~rejected[i] & ~_stood_for(i, own[i], agreement[i], wrong),
        )
        for i in range(len(views))
    ]
    return Fused(
        cloud=FusedCloud(
            **{name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
        ),
        doubts=pose_doubts(views, points),
        measured_px=tuple(len(one.pixel) for one in own),
        confirmed_px=tuple(int((confirmed > 0).sum()) for confirmed, _ in votes),
        rejected_px=tuple(int(bad.sum()) for bad in rejected),
    )


def _votes(
    answers: Mapping[int, ViewAgreement], points: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return how many other views confirm each point, and how many saw through it."""
    confirmed, against = np.zeros((2, points), dtype=np.int64)
    for answer in answers.values():
        confirmed += answer.met.agrees
        against += answer.through
    return confirmed, against


def _picture(
    view: MeasuredView, own: Points, which: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, "h w"]:
    where = np.zeros(view.depth_m.shape, dtype=bool)
    where[tuple(own.pixel[which].T)] = True
    return where


def _stood_for(
    i: int,
    own: Points,
    answers: Mapping[int, ViewAgreement],
    wrong: Sequence[Bool[np.ndarray, "_ _"]],
) -> Bool[np.ndarray, " n"]:
    """Return whether a view with finer pixels, or an earlier equal view, replaces each point."""
    better = np.zeros(len(own.pixel), dtype=bool)
    for j, answer in answers.items():
        met = answer.met
        theirs = met.there.area_m2
        finer = (theirs < own.area_m2) | ((theirs == own.area_m2) & (j < i))
        better |= met.agrees & finer & ~wrong[j][tuple(met.there.pixel.T)]
    return better


def _piece(
    i: int,
    own: Points,
    answers: Mapping[int, ViewAgreement],
    views: Sequence[MeasuredView],
    votes: tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]],
    keep: Bool[np.ndarray, " n"],
) -> dict[str, np.ndarray]:
    """Return the fields of `FusedCloud` for the points that come from a view."""
    weight = own.sureness / own.variance_along(own.normal)
    moved, noise = np.zeros_like(weight), weight * own.sureness
    for answer in answers.values():
        met = answer.met
        one = np.where(met.agrees, met.there.sureness / met.variance_m2, 0.0)
        moved += np.where(met.agrees, met.offset_m, 0.0) * one
        weight = weight + one
        noise = noise + np.where(met.agrees, one * met.there.sureness, 0.0)
    place = own.point_m + (moved / weight)[:, None] * own.normal
    first = np.zeros(len(keep), dtype=np.uint8) if i == 0 else _first_reason(answers[0], views[0])
    row, column = own.pixel.T
    confirmed, against = votes
    values = {
        "point_m": place,
        "normal": own.normal,
        "color": views[i].color[row, column],
        "sigma_m": np.sqrt(noise) / weight,
        "view": np.full(len(keep), i, dtype=np.uint8),
        "pixel": own.pixel,
        "views": (1 + confirmed).astype(np.uint8),
        "against": against.astype(np.uint8),
        "first_reason": first,
    }
    return {name: array[keep] for name, array in values.items()}


def _first_reason(answer: ViewAgreement, first: MeasuredView) -> UInt8[np.ndarray, " n"]:
    met = answer.met
    reason = first.reason[tuple(met.there.pixel.T)]
    cases = [met.agrees, ~met.inside, ~np.isfinite(met.there.sigma_m), answer.before]
    return np.select(
        cases, [np.uint8(0), np.uint8(OUTSIDE), reason, np.uint8(HIDDEN)], np.uint8(THROUGH)
    )
