"""Check the views' poses: agreement on common surfaces, and likely mistakes in wrong poses.

The poses of real views come from a robot and a hand-eye calibration. Points of one view are
compared with another view. The smallest motion that moves them onto its surface is fitted by robust
least squares of the distances along the normals. Directions that the common surface does not
determine (such as sideways on a plane) are left out. If the motion is larger than a scanner's bias
can be, a pose is wrong. If views hardly agree anywhere, the usual mistakes in a pose are tried.
GICP in the library small-gicp finds a shift of 5 mm with an error of 0.2 mm. But if a view's pose
is inverted, GICP moves the view by 20 mm onto another view's floor, which hides this mistake.

Source: Y. Chen, G. Medioni, "Object modelling by registration of multiple range images", 1992
(distances to planes).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...base.frames import axis_rotation, inverse, rigid, transform_points
from ...base.robust import robust_sigma
from .looking import SIGMAS, meet
from .view import MeasuredView, Points, points_of

POINTS = 4000  # number of a view's points that are compared with another view
LEAST_POINTS = 200  # least number of compared points on planes for a conclusion
# largest deviation of a point in each step, as a share of the depth and in addition to 4 sigma
GATES = (0.02, 0.02, 0.01, 0.01, 0.005, 0.005, 0.0025, 0.0025)
ALIGNED = 0.7  # least cosine between two normals of one surface
DETERMINED = 1e-4  # largest standard deviation of a determined direction, as a share of depth
OFF = 4e-4  # largest motion of views that agree, as a share of depth; simulated views reach 1e-4
LEAST_SHARE = 0.3  # least share of compared points on one surface if both poses are correct


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Agreement of one view's points with another view.

    Attributes:
        points: number of points at which the other view has a depth.
        share: share of these points that agree with the other view after the fitted motion.
        shift_m: shift of the points' centre by the motion that moves them onto the other surface.
        turn_rad: angle of the motion's rotation.
        off: size of the motion at the points, as a share of the depth.
    """

    points: int
    share: float
    shift_m: Float[np.ndarray, "3"]
    turn_rad: float
    off: float

    @property
    def meets(self) -> bool:
        return self.points >= LEAST_POINTS and self.share >= LEAST_SHARE

    @property
    def agrees(self) -> bool:
        return self.meets and self.off <= OFF


def pose_doubts(views: Sequence[MeasuredView], points: Sequence[Points]) -> tuple[str, ...]:
    """Return sentences about the views that disagree with other views, with remedies."""
    pairs = agreements(views, points)
    lonely = [i for i in range(len(views)) if not any(pairs[p].agrees for p in pairs if i in p)]
    if len(views) < 2 or not lonely:
        return ()
    if len(lonely) < len(views):
        return tuple(_differs(i, views, points, pairs) for i in lonely)
    if len(views) == 2 and pairs[0, 1].meets:
        return (f"{_displaced(views[0], views[1], pairs[0, 1])}: one of the two poses is off",)
    return (_all_differ(views, points),)


def agreements(
    views: Sequence[MeasuredView], points: Sequence[Points]
) -> dict[tuple[int, int], Agreement]:
    """Return the agreement for each pair of views."""
    own = [_some(view_points) for view_points in points]
    pairs = combinations(range(len(views)), 2)
    return {(i, j): _agreement(own[i], views[j], points[j]) for i, j in pairs}


def _all_differ(views: Sequence[MeasuredView], points: Sequence[Points]) -> str:
    """Return a sentence for views of which no two agree; all poses may have the same mistake."""
    names = ", ".join(view.name for view in views)
    none = f"no two of the views {names} agree where both measured a surface"
    for what, change in _MISTAKES.items():
        changed = [replace(view, T_world_cam=change(view.T_world_cam)) for view in views]
        pairs = agreements(changed, [points_of(view) for view in changed])
        if all(one.agrees for one in pairs.values() if one.points >= LEAST_POINTS):
            if any(one.agrees for one in pairs.values()):
                return f"{none}, but with all poses {what} they do: change the poses so"
    return f"{none}{_remedy(len(views) - 1, views, points)}"


def _differs(
    i: int,
    views: Sequence[MeasuredView],
    points: Sequence[Points],
    pairs: Mapping[tuple[int, int], Agreement],
) -> str:
    """Return a sentence about a view that agrees with no other view, although other views do."""
    mine = {pair: one for pair, one in pairs.items() if i in pair}
    pair, best = max(mine.items(), key=lambda item: (item[1].meets, item[1].points))
    if best.meets:
        other = pair[0] if pair[1] == i else pair[1]
        to_other = best if pair[0] == i else replace(best, shift_m=-best.shift_m)
        doubt = _displaced(views[i], views[other], to_other)
        return f"{doubt}: its pose is off, or its depth is biased"
    if best.points < LEAST_POINTS:
        none = f"view {views[i].name} measured nothing where another view did"
    else:
        none = (
            f"view {views[i].name} agrees with no other view: of the {best.points} points that "
            f"were compared, {best.share:.0%} lie on one surface"
        )
    return f"{none}{_remedy(i, views, points)}"


def _displaced(view: MeasuredView, other: MeasuredView, one: Agreement) -> str:
    x, y, z = along = 1e3 * (view.T_world_cam[:3, :3].T @ one.shift_m)
    return (
        f"view {view.name} does not lie where view {other.name} measured the same surface "
        f"({one.points} points were compared): it would have to move by "
        f"{np.linalg.norm(along):.2f} mm (along its camera's axes {x:.2f}, {y:.2f}, {z:.2f}) and "
        f"to turn by {np.degrees(one.turn_rad):.2f} degrees"
    )


def _remedy(i: int, views: Sequence[MeasuredView], points: Sequence[Points]) -> str:
    """Return advice: the usual mistake in a pose that explains why a view agrees with no other."""
    T = views[i].T_world_cam
    for what, change in _MISTAKES.items():
        own = _moved(_some(points[i]), change(T) @ inverse(T))
        pairs = [_agreement(own, views[j], points[j]) for j in range(len(views)) if j != i]
        if best := max((one.share for one in pairs if one.meets), default=0.0):
            name = views[i].name
            return f"; with the pose of view {name} {what}, {best:.0%} would: change the pose so"
    return "; to invert its pose does not help: check the pose (camera to world, in metres)"


def _turned(quarters: int) -> Callable[[Float[np.ndarray, "4 4"]], Float[np.ndarray, "4 4"]]:
    R = axis_rotation("z", quarters * np.pi / 2)
    return lambda T: T @ rigid(R, np.zeros(3))


_MISTAKES: Mapping[str, Callable[[Float[np.ndarray, "4 4"]], Float[np.ndarray, "4 4"]]] = {
    "inverted": inverse,
    "given the opposite translation": lambda T: rigid(T[:3, :3], -T[:3, 3]),
    "turned by 90 degrees about the camera's axis": _turned(1),
    "turned by 180 degrees about the camera's axis": _turned(2),
    "turned by 270 degrees about the camera's axis": _turned(3),
}


def _some(points: Points) -> Points:
    """Return a sample of the points that are on planes, spread evenly over the picture."""
    pixel = np.argwhere(points.known & points.plane)
    index = np.linspace(0, len(pixel) - 1, min(POINTS, len(pixel))).astype(np.int64)
    return points.at(pixel[index])


def _agreement(own: Points, view: MeasuredView, points: Points) -> Agreement:
    T, off = np.eye(4), 0.0
    shift_m, turn_rad = np.zeros(3), 0.0
    for gate in GATES:
        moved = _moved(own, T)
        met = meet(moved, view, points)
        there = met.there
        normal = moved.normal + there.normal
        variance_m2 = moved.variance_along(moved.normal) + met.variance_m2
        reach_m = gate * met.depth_m + SIGMAS * np.sqrt(variance_m2)
        near = met.inside & there.plane & (np.abs(met.offset_m) <= reach_m)
        near &= (moved.normal * there.normal).sum(axis=-1) > ALIGNED
        if near.sum() < LEAST_POINTS:
            break
        depth_m = float(np.median(met.depth_m[near]))
        middle = moved.point_m[near].mean(axis=0)
        arm = moved.point_m[near] - middle
        radius_m = float(np.sqrt(np.square(arm).sum(axis=-1).mean()))
        across = normal[near] / np.linalg.norm(normal[near], axis=-1, keepdims=True)
        row = np.concatenate([np.cross(arm, across) / radius_m, across], axis=1)
        step = _least_squares(
            row,
            met.offset_m[near],
            variance_m2[near],
            kernel_m=gate * depth_m / 4,
            determined_m=DETERMINED * depth_m,
        )
        R = Rotation.from_rotvec(step[:3] / radius_m).as_matrix()
        T = rigid(R, middle + step[3:] - R @ middle) @ T
        before = transform_points(inverse(T), middle[None])[0]
        shift_m = middle - before
        turn_rad = float(Rotation.from_matrix(T[:3, :3]).magnitude())
        off = float(np.hypot(turn_rad * radius_m, np.linalg.norm(shift_m))) / depth_m
    met = meet(_moved(own, T), view, points)
    both = met.inside & np.isfinite(met.there.sigma_m)
    share = float(met.agrees[both].mean()) if both.any() else 0.0
    return Agreement(
        points=int(both.sum()), share=share, shift_m=shift_m, turn_rad=turn_rad, off=off
    )


def _moved(own: Points, T: Float[np.ndarray, "4 4"]) -> Points:
    R = T[:3, :3].T
    return replace(
        own, point_m=transform_points(T, own.point_m), toward=own.toward @ R, normal=own.normal @ R
    )


def _least_squares(
    row: Float[np.ndarray, "n 6"],
    offset_m: Float[np.ndarray, " n"],
    variance_m2: Float[np.ndarray, " n"],
    *,
    kernel_m: float,
    determined_m: float,
) -> Float[np.ndarray, "6"]:
    """Return a Cauchy-weighted least-squares solution in the directions that points determine.

    A direction is determined to a standard deviation of `determined_m`. The caller begins with a
    wide kernel: a sideways shift shows only on slopes, which are outliers next to a flat floor.
    """
    spread_m = float(robust_sigma(offset_m - np.median(offset_m)))
    noise_m2 = np.maximum(variance_m2, spread_m**2)
    value, vector = np.linalg.eigh(row.T @ (row / noise_m2[:, None]))
    along = row @ vector[:, value > determined_m**-2]
    x = np.zeros(along.shape[1])
    for _ in range(5):
        weight = 1 / (noise_m2 + kernel_m**2 + np.square(offset_m - along @ x))
        x = np.linalg.solve(along.T @ (weight[:, None] * along), along.T @ (weight * offset_m))
    return vector[:, value > determined_m**-2] @ x
