"""Metrological quantities from points and pictures: fits, ranges, noise, spacing, modulation.

All functions depend only on arrays, not on artefacts or scanners.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from ...rig.pattern import Code, Frame

DROPPED_SHARE = (3, 1000)  # largest share of points to drop by VDI/VDE 2634 part 2
ITERATIONS = 50
CONVERGED = 1e-12  # size of the last step, as a share of the radius


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviations:
    """Distances of points from a fitted shape.

    `range_m` is the largest minus the smallest signed distance, and `std_m` the standard deviation
    of the distances. Both are over the `points` that remain after `dropped` points are removed.
    """

    range_m: float
    std_m: float
    points: int
    dropped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneFit:
    """The plane `normal . p = offset_m`, with a normal that makes the offset positive."""

    normal: Float[np.ndarray, "3"]
    offset_m: float

    def distance_m(self, point: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        return point @ self.normal - self.offset_m


@dataclass(frozen=True, slots=True, kw_only=True)
class SphereFit:
    centre_m: Float[np.ndarray, "3"]
    radius_m: float

    def distance_m(self, point: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Return the signed distance of points from the surface, positive outside."""
        return np.linalg.norm(point - self.centre_m, axis=-1) - self.radius_m


def fit_plane(point: Float[np.ndarray, "n 3"]) -> PlaneFit:
    """Return the plane with the least sum of squared distances (orthogonal regression).

    Raises:
        ValueError: fewer than three points.
    """
    if len(point) < 3:
        raise ValueError(
            f"a plane needs 3 points, not {len(point)}: check that it is in view and decoded"
        )
    middle = point.mean(axis=0)
    off = point - middle
    normal = np.linalg.eigh(off.T @ off)[1][:, 0]
    offset_m = float(normal @ middle)
    if offset_m < 0:
        normal, offset_m = -normal, -offset_m
    return PlaneFit(normal=normal, offset_m=offset_m)


def fit_sphere(point: Float[np.ndarray, "n 3"]) -> SphereFit:
    """Return the sphere with the least sum of squared radial distances; its radius is free.

    Gauss-Newton steps on `|p - c| - r` start at the algebraic fit `|p|^2 = 2 c . p + r^2 - |c|^2`.

    Raises:
        ValueError: fewer than four points, or points that do not make a sphere.
    """
    if len(point) < 4:
        raise ValueError(
            f"a sphere needs 4 points, not {len(point)}: check that it is in view and decoded"
        )
    origin = point.mean(axis=0)
    p = point - origin
    linear = np.column_stack([2 * p, np.ones(len(p))])
    solution = np.linalg.lstsq(linear, np.square(p).sum(axis=1), rcond=None)[0]
    centre, radius = solution[:3], math.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0))
    for _ in range(ITERATIONS):
        away = p - centre
        length = np.linalg.norm(away, axis=1)
        jacobian = np.column_stack([away / length[:, None], np.ones(len(p))])
        step = np.linalg.lstsq(jacobian, length - radius, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3])
        if np.abs(step).max() <= CONVERGED * abs(radius):
            return SphereFit(centre_m=centre + origin, radius_m=float(radius))
    raise ValueError(
        f"no sphere fits these {len(point)} points: they span "
        f"{np.ptp(point, axis=0).tolist()} m, too little of a sphere or none"
    )


def without_worst(distance: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return a mask of all points but the 3 in 1000 (rounded down) with the largest distances."""
    worst = len(distance) * DROPPED_SHARE[0] // DROPPED_SHARE[1]
    keep = np.ones(len(distance), dtype=bool)
    if worst:
        keep[np.argpartition(np.abs(distance), -worst)[-worst:]] = False
    return keep


def flatness(point: Float[np.ndarray, "n 3"]) -> tuple[PlaneFit, Deviations]:
    """Return the best-fit plane, and the deviations of points from it.

    A plane is fitted to all points, the worst 3 in 1000 points are dropped, and a plane is fitted
    to the rest. Source: VDI/VDE 2634 part 2, as quoted by secondary sources.
    """
    keep = without_worst(fit_plane(point).distance_m(point))
    fit = fit_plane(point[keep])
    return fit, _deviations(fit.distance_m(point[keep]), len(point))


def probing(point: Float[np.ndarray, "n 3"]) -> tuple[SphereFit, Deviations]:
    """Return the best-fit sphere and the deviations from it; drop points as in `flatness`."""
    keep = without_worst(fit_sphere(point).distance_m(point))
    fit = fit_sphere(point[keep])
    return fit, _deviations(fit.distance_m(point[keep]), len(point))


def _deviations(distance: Float[np.ndarray, " n"], measured: int) -> Deviations:
    return Deviations(
        range_m=float(np.ptp(distance)),
        std_m=float(distance.std()),
        points=len(distance),
        dropped=measured - len(distance),
    )


def temporal_noise_m(depth_m: Float[np.ndarray, "n h w"], where: Bool[np.ndarray, "h w"]) -> float:
    """Return the standard deviation of a pixel's depth from shot to shot (median over pixels).

    The sample variance of n normal values is `sigma^2 / (n - 1)` times a chi-squared variable with
    n - 1 degrees of freedom. Sigma follows from the medians of the variances and of this variable.

    Args:
        depth_m: n captures of one scene; only pixels with depth in all captures count.

    Returns:
        The standard deviation; NaN if no pixel counts.

    Raises:
        ValueError: fewer than two captures.
    """
    n = len(depth_m)
    if n < 2:
        raise ValueError(f"{n} captures have no scatter; give at least 2")
    sample = depth_m[:, where].astype(np.float64)
    sample = sample[:, np.isfinite(sample).all(axis=0)]
    if sample.shape[1] == 0:
        return math.nan
    median_m2 = float(np.median(sample.var(axis=0, ddof=1)))
    return math.sqrt(median_m2 * (n - 1) / float(chi2.median(n - 1)))


def depth_error_m(error_m: Float[np.ndarray, " n"]) -> float:
    """Return the standard deviation of measured minus true depth over the pixels of one shot.

    The pixels farthest from the median are dropped as in `flatness`. Unlike temporal noise, the
    result contains errors that are the same in every shot. Neither contains an error that is the
    same for all pixels.
    """
    keep = without_worst(error_m - np.median(error_m))
    return float(error_m[keep].astype(np.float64).std())


def point_spacing_m(point: Float[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"]) -> float:
    """Return the median distance between points of neighbouring pixels, across the camera's axis.

    Differences in depth are ignored, because they are noise on a facing plane. The result is NaN
    if no two neighbouring pixels have points.
    """
    xy = np.where((where & np.isfinite(point[..., 2]))[..., None], point[..., :2], np.nan)
    steps = [np.linalg.norm(np.diff(xy, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    step_m = np.concatenate(steps)
    step_m = step_m[np.isfinite(step_m)]
    return float(np.median(step_m)) if len(step_m) else math.nan


def modulation(
    code: Code, light: Float[np.ndarray, "n h w"], where: Bool[np.ndarray, "h w"]
) -> dict[str, float]:
    """Return the mean modulation of each bit and each set of phases over pixels; 1 is perfect.

    With white W and black B, the modulation is `|P - I| / (W - B)` for a binary frame P and its
    inverse I, `|2 P - W - B| / (W - B)` for a frame without an inverse, and twice the amplitude
    divided by W - B for phases or lines. Lines with a period p reach at most 4 / p.

    Args:
        light: one linear picture per frame, in any unit.

    Returns:
        Modulation by the name of the (first) frame. Incomplete sets of phases (as in micro phase
        shifting) are left out. The result is empty for a code without white and black frames.
    """
    value_of = {frame: light[k, where].astype(np.float64) for k, frame in enumerate(code.frames)}
    ends = {frame.kind: picture for frame, picture in value_of.items() if frame.axis is None}
    if not {"white", "black"} <= ends.keys():
        return {}
    white, black = ends["white"], ends["black"]
    lit = white > black
    share_of = {}
    for frame, picture in value_of.items():
        swing = _swing(frame, picture, value_of, white + black)
        if swing is not None and lit.any():
            share_of[frame.name] = float((swing[lit] / (white - black)[lit]).mean())
    return share_of


def _swing(
    frame: Frame,
    picture: Float[np.ndarray, " n"],
    value_of: dict[Frame, Float[np.ndarray, " n"]],
    both_ends: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"] | None:
    """Return bright minus dark light for the first frame of a bit or set of phases, else None."""
    if frame.kind in ("gray", "complementary") and not frame.inverse:
        inverted = [other for other in value_of if _is_inverse(other, frame)]
        return np.abs(picture - value_of[inverted[0]] if inverted else 2 * picture - both_ends)
    if frame.kind in ("phase", "line") and frame.step == 0:
        own = [o for o in value_of if (o.kind, o.axis, o.period_px) == _key(frame)]
        if len(own) == frame.steps:
            turn = np.exp(-2j * np.pi * np.array([other.step for other in own]) / frame.steps)
            return 4 / frame.steps * np.abs(turn @ np.stack([value_of[other] for other in own]))
    return None


def _key(frame: Frame) -> tuple[str, str | None, float]:
    return frame.kind, frame.axis, frame.period_px


def _is_inverse(other: Frame, frame: Frame) -> bool:
    same = (*_key(other), other.bit, other.xor_bit) == (*_key(frame), frame.bit, frame.xor_bit)
    return other.inverse and same
