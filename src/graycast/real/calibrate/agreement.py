"""Selection and fit of the views that agree on one pose between the devices.

A median over the views cannot show that a device moved halfway through them. So the fit with one
pose between the devices is compared with a fit in which each view has its own pose. If the first
fit has far larger residuals, the views are divided into groups with one pose each.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Int
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from .adjust import Adjustment, Stands, adjust, adjust_stands
from .board import CalibrationError
from .observing import MIN_VIEWS, MINORITY, Observed

SPOILING, SPOILING_FLOOR_PX = 6.0, 0.5  # Above both limits, a view spoils the fit of all views.
MOST_LOST = 0.4  # A view is bad if a larger share of its corners are outliers.
OUTLYING = 2.5  # A view fits badly if its residual is more than this many times the median view's.
OUTLYING_FLOOR_PX = 0.05  # A view with a smaller residual is always good.
# One common pose does not suffice if its residual exceeds APART_PX and also APART times that with a
# pose per view. In 50 simulated good calibrations with bent boards, the ratio was at most 1.2.
APART, APART_PX = 2.0, 0.05
EXPLAINED = 1.5  # A pose per group suffices up to this factor of the residual with a pose per view.
MOST_GROUPS = 6
Fit = TypeVar("Fit", Stands, Adjustment)
CHANCE = 1e-3  # Below this p-value, noise of the corners does not explain the scatter of poses.


def fit_agreeing(
    observed: Observed, sizes_px: Sequence[tuple[int, int]], radial_terms: int, tangential: bool
) -> tuple[Observed, Adjustment]:
    """Return the views that agree on one rig, and their fit.

    The standard deviations of the fit include the scatter of poses between views.

    Args:
        sizes_px: (width, height) of the camera and of the projector.

    Raises:
        CalibrationError: too few views are left, or a device moved between two groups of them.
    """
    terms: dict[str, Any] = {
        "camera_size_px": sizes_px[0],
        "projector_size_px": sizes_px[1],
        "radial_terms": radial_terms,
        "tangential": tangential,
    }
    one: Callable[..., Adjustment] = partial(adjust, **terms)
    some: Callable[..., Stands] = partial(adjust_stands, **terms)
    while True:
        corners, views = observed.corners, len(observed.views)
        each = _converged(some, corners, np.arange(views))
        fit = _converged(one, corners)
        faults = _parted(observed, each, fit, some)
        if not faults:
            fit = fit or one(corners)  # If the fit did not converge, this raises its error.
            faults = _spoiling(observed, fit) or _worst_outlier(observed, fit)
            if not faults:
                return observed, replace(fit, deviation=_widened(fit, each, views))
        observed = observed.less(faults)


def _converged(fitted: Callable[..., Fit], *arguments: Any) -> Fit | None:
    """Return a fit; None if it does not converge."""
    try:
        return fitted(*arguments)
    except CalibrationError:
        return None


def _parted(
    observed: Observed, each: Stands | None, fit: Adjustment | None, some: Callable[..., Stands]
) -> dict[str, str]:
    """Return the few views whose pose between the devices differs from most views, with reasons.

    Raises:
        CalibrationError: too many views differ, or no grouping of the views fits well enough.
    """
    if each is None or (fit is not None and not _above(fit.sigma_px, each.sigma_px, APART)):
        return {}
    for group in _partings(each):
        parted = some(observed.corners, group)
        if _above(parted.sigma_px, each.sigma_px, EXPLAINED):
            continue
        usual = int(np.bincount(group).argmax())
        others = np.flatnonzero(group != usual)
        if len(others) > MINORITY * len(group):
            raise CalibrationError(_moved(observed, group, parted, fit))
        since = _since(others, group)
        return {
            observed.views[k].name: f"the devices are {_apart(parted, usual, int(group[k]))} from "
            f"where the other views have them: the board or a device may have moved{since}"
            for k in others
        }
    if fit is None:
        return {}
    raise CalibrationError(
        f"the camera's residual is {fit.sigma_px[0]:.2g} px and the projector's "
        f"{fit.sigma_px[1]:.2g} px, {each.sigma_px[0]:.2g} and {each.sigma_px[1]:.2g} px if each "
        "view has the devices in a pose of its own: a device moved more than once, or is loose; "
        "fix both to one frame and take new views"
    )


def _above(sigma_px, least_px, factor: float) -> bool:
    return bool(((sigma_px > factor * least_px) & (sigma_px > APART_PX)).any())


def _partings(each: Stands) -> Iterator[Int[np.ndarray, " views"]]:
    """Yield groupings of the views: first two groups of successive views, then Ward's clusters.

    The distance of two clusters is the increase of the squared residuals (in variances) if the
    clusters share a pose; the nearest two are joined.

    Source: J. H. Ward, "Hierarchical grouping to optimize an objective function", JASA 1963.
    """
    views = len(each.number)
    splits = [np.arange(views) >= first for first in range(1, views)]
    yield min(splits, key=lambda late: _scatter(each, late)).astype(np.intp)
    groups = [[k] for k in range(views)]
    by_count = {}
    while len(groups) > 1:
        pairs = combinations(range(len(groups)), 2)
        a, b = min(pairs, key=lambda pair: _cost(each, groups[pair[0]], groups[pair[1]]))
        groups[a] += groups.pop(b)
        by_count[len(groups)] = [list(group) for group in groups]
    for count in range(2, min(MOST_GROUPS, views - 1) + 1):
        label = np.zeros(views, dtype=np.intp)
        for number, group in enumerate(by_count[count]):
            label[group] = number
        yield label


def _scatter(each: Stands, late) -> float:
    return sum(_squares(each, np.flatnonzero(late == side)) for side in (False, True))


def _cost(each: Stands, a: list[int], b: list[int]) -> float:
    return _squares(each, a + b) - _squares(each, a) - _squares(each, b)


def _squares(each: Stands, some) -> float:
    """Return the sum of squared deviations of some views' poses from their mean, in variances."""
    information, number = each.information[some], each.number[some]
    weighted = np.einsum("kij,kj->ki", information, number)
    mean = np.linalg.lstsq(information.sum(axis=0), weighted.sum(axis=0), rcond=None)[0]
    away = number - mean
    return float(np.einsum("ki,kij,kj->", away, information, away))


def _moved(observed: Observed, group, parted: Stands, fit: Adjustment | None) -> str:
    """Return the error text for views whose largest group is not a clear majority."""
    members = [np.flatnonzero(group == k) for k in range(group.max() + 1)]
    members.sort(key=lambda some: some[0])
    names = " and ".join(_names(observed, some) for some in members)
    apart = _apart(parted, *(int(group[own[0]]) for own in members[:2]))
    residual = "no rig fits all views" if fit is None else (
        f"one rig for all views has a residual of {fit.sigma_px.max():.2g} px, one for each "
        f"group {parted.sigma_px.max():.2g} px"
    )  # fmt: skip
    return (
        f"{names} have the devices {apart} apart: a device moved between them; calibrate with one "
        f"group ({residual})"
    )


def _names(observed: Observed, some) -> str:
    name = [observed.views[k].name for k in some]
    if len(some) == 1:
        return f"view {name[0]}"
    if len(some) > 2 and some[-1] - some[0] == len(some) - 1:
        return f"views {name[0]} to {name[-1]}"
    return f"views {', '.join(name)}"


def _apart(parted: Stands, a: int, b: int) -> str:
    """Return a text with the rotation and shift of the projector between two stands."""
    T_a, T_b = parted.T_cam_proj[a], parted.T_cam_proj[b]
    turn_rad = Rotation.from_matrix(T_a[:3, :3].T @ T_b[:3, :3]).magnitude()
    shift_m = np.linalg.norm(T_b[:3, 3] - T_a[:3, 3])
    return f"{math.degrees(turn_rad):.2g} degrees and {1e3 * shift_m:.2g} mm"


def _since(others, group) -> str:
    """Return an addition to the reason if the last views are left out, else an empty text."""
    last = others[-1] == len(group) - 1 and len(others) > 1
    if not last or others[-1] - others[0] != len(others) - 1:
        return ""
    return "; if a device did, this rig is that from before, so take new views"


def _spoiling(observed: Observed, fit: Adjustment) -> dict[str, str]:
    """Return the worst view and the reason if it fits far worse than the other views, else none."""
    index = range(len(observed.views))
    lost = [1 - fit.inlier[observed.corners.view == k].mean() for k in index]
    if max(lost) > MOST_LOST:
        worst = int(np.argmax(lost))
        share = f"{100 * lost[worst]:.0f} % of its corners disagree with the other views"
        return {observed.views[worst].name: f"{share}: its code may be wrong"}
    spoiling = {}
    for device in ("camera", "projector"):
        size_px = np.linalg.norm(getattr(fit, f"{device}_residual_px"), axis=1)
        rms_px = [float(np.median(size_px[observed.corners.view == k])) for k in index]
        worst = int(np.argmax(rms_px))
        others_px = float(np.median(np.delete(rms_px, worst)))
        if rms_px[worst] > max(SPOILING * others_px, SPOILING_FLOOR_PX):
            spoiling[rms_px[worst] / max(others_px, OUTLYING_FLOOR_PX)] = {
                observed.views[worst].name: f"its {device} residual is {rms_px[worst]:.2f} px, "
                f"others have {others_px:.2f} px (medians): the board or a device may have moved"
            }
    return spoiling[max(spoiling)] if spoiling else {}


def _worst_outlier(observed: Observed, fit: Adjustment) -> dict[str, str]:
    """Return the worst of the views that fit badly and the reason, unless too few would remain."""
    left = len(observed.views) - 1
    enough = (1 - MINORITY) * (len(observed.views) + len(observed.left_out))
    outliers = outlying(observed, fit)
    if not outliers or left < max(MIN_VIEWS, enough):
        return {}
    worst = max(outliers, key=lambda name: outliers[name][0])
    return {worst: outliers[worst][1]}


def outlying(observed: Observed, fit: Adjustment) -> dict[str, tuple[float, str]]:
    """Return the views that fit badly, each with its ratio to the median residual and a reason."""
    views: dict[str, tuple[float, str]] = {}
    for device in ("camera", "projector"):
        size_px = np.linalg.norm(getattr(fit, f"{device}_residual_px"), axis=1)
        residual_px = [  # With a median, a few wrong corners do not spoil a view.
            float(np.median(size_px[observed.corners.view == k]))
            for k in range(len(observed.views))
        ]
        usual_px = float(np.median(residual_px))
        for view, value_px in zip(observed.views, residual_px, strict=True):
            ratio = value_px / max(usual_px, 1e-9)
            if ratio > OUTLYING and value_px > OUTLYING_FLOOR_PX:
                views[view.name] = (
                    ratio,
                    f"its {device} residual is {value_px:.3f} px, the median view has "
                    f"{usual_px:.3f} (medians): the board may have moved during its stack, or its "
                    "pictures are blurred",
                )
    return views


def _widened(fit: Adjustment, each: Stands | None, views: int) -> dict[str, float]:
    """Return standard deviations, increased if poses scatter more between views than by noise.

    If the board is bent or moved, the errors of its corners are correlated, so the number of views
    counts, not that of corners. With noise alone, the sum of squares (in variances) with one pose
    for all views exceeds the sum with a pose per view by `6 (views - 1)` on average.

    Source: R. T. Birge, "The calculation of errors by the method of least squares", Physical
    Review 40, 1932.
    """
    if each is None or views < 2:
        return fit.deviation
    both = fit.inlier & each.inlier
    ours, theirs = (
        np.square(one.residual_px[both] / fit.sigma_px[:, None]).sum() for one in (fit, each)
    )
    unknowns = 6 * (views - 1)
    ratio = (ours - theirs) / unknowns
    rest = max(4 * int(both.sum()) - 6 * (2 * views) - 18, 1)
    if not ratio > f_distribution.isf(CHANCE, unknowns, rest):
        return fit.deviation
    return {name: math.sqrt(ratio) * value for name, value in fit.deviation.items()}
