"""The order in which detected parts are tried, and candidate grips on these parts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ....base.frames import inverse, transform_points
from ....rig.optics import points, project
from ....world.scene import Bin
from ...grasp import DepthView, Grip, SuctionSearch
from ...pose import PoseModel, find_pose, find_pose_in_box
from ..arm.obstacles import FLOOR_M, WALL_M

LEAST_AREA = 0.3  # A detection needs at least this share of the largest detection's pixels.
LEAST_POSE = 0.3  # Poses with a lower score give no grips.
BESIDE_PX = 2  # The search for covering parts extends this far outside the outline.
COVERED_M = 8e-3  # A surface that is nearer to the camera by more than this covers the part.
COVERED_SHARE = 0.08  # A part counts as covered if more than this share of its outline is.
PLACES = 40  # number of grips that each round of the search without a model tries per detection


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A candidate part in the picture: its mask, its box [x, y, columns, rows], or both.

    `kind` is the index among the cell's parts, or None if unknown. `T_cam_part` is the true pose
    if the robot is to use it, otherwise None.
    """

    kind: int | None
    score: float
    mask: Bool[np.ndarray, "h w"] | None = None
    box_px: Float[np.ndarray, "4"] | None = None
    T_cam_part: Float[np.ndarray, "4 4"] | None = None

    def __post_init__(self) -> None:
        if self.mask is None and self.box_px is None:
            raise ValueError("a target must have a mask or a box")

    def inside(self, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
        if self.mask is not None:
            return self.mask
        inside = np.zeros(shape, bool)
        left, top, columns, rows = np.rint(np.asarray(self.box_px)).astype(int)
        inside[max(top, 0) : top + rows, max(left, 0) : left + columns] = True
        return inside


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """A grip in the world: the pose of the tool's tip, its score, and the part to grip."""

    T_world_tool: Float[np.ndarray, "4 4"]
    score: float
    target: Candidate
    opening_m: float | None = None
    T_part_tool: Float[np.ndarray, "4 4"] | None = None
    T_cam_part: Float[np.ndarray, "4 4"] | None = None

    @property
    def place_m(self) -> Float[np.ndarray, "3"]:
        return self.T_world_tool[:3, 3]


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownPart:
    """A kind of part whose grips are known."""

    model: PoseModel
    grips: tuple[Grip, ...]


def ranked(
    targets: Sequence[Candidate], view: DepthView, failed: Sequence[Float[np.ndarray, "3"]] = ()
) -> list[list[Candidate]]:
    """Return the detections with enough depth, in the order in which the robot tries them.

    The first group contains free parts, the second contains parts that another part covers, and the
    third contains parts on which a grip failed before. Each group begins with the highest part.
    """
    point_m = points(view.camera, view.depth_m)
    area, height = [], []
    for target in targets:
        inside = target.inside(view.depth_m.shape) & np.isfinite(view.depth_m)
        area.append(int(inside.sum()))
        point = transform_points(view.T_world_cam, point_m[inside])
        height.append(float(np.median(point[:, 2])) if len(point) else -np.inf)
    least = LEAST_AREA * max(area, default=0)
    order = sorted(range(len(targets)), key=lambda i: -height[i])
    groups: list[list[Candidate]] = [[], [], []]
    for i in order:
        if area[i] > 0 and area[i] >= least:
            again = _holds_any(targets[i], view, failed)
            covered = covered_share(targets[i].inside(view.depth_m.shape), view.depth_m)
            groups[2 if again else int(covered > COVERED_SHARE)].append(targets[i])
    return groups


def covered_share(inside: Bool[np.ndarray, "h w"], depth_m: Float[np.ndarray, "h w"]) -> float:
    """Return the share of an outline's pixels next to which a much nearer surface is.

    Such a surface belongs to another part, which covers this part or is close in front of it.
    """
    around = np.ones((3, 3), bool)
    rim = inside & ~ndimage.binary_erosion(inside, around) & np.isfinite(depth_m)
    outside_m = np.where(inside | np.isnan(depth_m), np.inf, depth_m)
    nearest_m = ndimage.minimum_filter(outside_m, size=2 * BESIDE_PX + 1)
    covered = rim & (nearest_m < depth_m - COVERED_M)
    return float(covered.sum() / max(int(rim.sum()), 1))


def _holds_any(
    target: Candidate, view: DepthView, place_m: Sequence[Float[np.ndarray, "3"]]
) -> bool:
    """Return whether any of the places (in the world) is within a detection's outline."""
    if not len(place_m):
        return False
    inside = target.inside(view.depth_m.shape)
    at = project(view.camera, transform_points(inverse(view.T_world_cam), np.stack(place_m)))
    column, row = np.rint(at).astype(int).T
    within = (row >= 0) & (row < len(inside)) & (column >= 0) & (column < inside.shape[1])
    return bool(inside[row[within], column[within]].any())


def whole_bin(view: DepthView, box: Bin) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels inside the bin and above its floor, which may show parts."""
    depth_m = np.nan_to_num(view.depth_m)
    point = transform_points(view.T_world_cam, points(view.camera, depth_m))
    half = np.array(box.inner_m[:2]) / 2 - WALL_M
    inside = (np.abs(point[..., :2]) < half).all(axis=-1) & (point[..., 2] > FLOOR_M)
    return inside & np.isfinite(view.depth_m)


def aims_by_pose(
    targets: Sequence[Candidate],
    view: DepthView,
    known: Mapping[int, KnownPart],
    *,
    most_lean_rad: float,
    posed: list[Candidate],
) -> list[Aim]:
    """Return the known grips of the parts, moved to the parts' poses.

    This function appends the targets whose pose is known to `posed`.
    """
    aims = []
    for target in targets:
        part = known[0 if target.kind is None else target.kind]
        T_cam_part = target.T_cam_part
        if T_cam_part is None:
            T_cam_part = _pose(part.model, target, view)
        if T_cam_part is None:
            continue
        posed.append(target)
        T_world_part = view.T_world_cam @ T_cam_part
        for grip in part.grips:
            T = T_world_part @ grip.T_part_tool
            if T[2, 2] >= np.cos(most_lean_rad):
                aims.append(
                    Aim(
                        T_world_tool=T,
                        score=grip.score,
                        target=target,
                        opening_m=grip.opening_m,
                        T_part_tool=grip.T_part_tool,
                        T_cam_part=T_cam_part,
                    )
                )
    return aims


def _pose(model: PoseModel, target: Candidate, view: DepthView) -> Float[np.ndarray, "4 4"] | None:
    # A detector's masks are coarse, and the estimated pose depends on the mask's outline. With the
    # detector's boxes, more poses are right (docs/measurements/pose.md). The truth has only masks.
    if target.box_px is not None:
        box_px = np.asarray(target.box_px)
        match = find_pose_in_box(model, view.depth_m, view.camera, box_px)
    else:
        match = find_pose(model, view.depth_m, view.camera, np.asarray(target.mask))
    return None if match.score < LEAST_POSE else match.T_cam_part


def aims_in_depth(
    targets: Sequence[Candidate], search: SuctionSearch, *, one_part: bool, count: int, seed: int
) -> list[Aim]:
    """Return grips on the measured surface, without a model of the part."""
    view = search.view
    return [
        Aim(T_world_tool=view.T_world_cam @ grip.T_cam_tool, score=grip.score, target=target)
        for number, target in enumerate(targets)
        for grip in search.grips(
            target.inside(view.depth_m.shape), one_part=one_part, count=count, seed=seed + number
        )
    ]


def trial_order(aims: Sequence[Aim]) -> list[Aim]:
    """Sort grips by descending score, rounded to one decimal, then by descending height."""
    return sorted(aims, key=lambda aim: (-round(aim.score, 1), -float(aim.place_m[2])))


def spread(aims: Sequence[Aim], apart_m: float, *, round_tool: bool) -> Iterator[Aim]:
    """Yield the grips, but skip those with almost the same tip, axis and rotation as another."""
    taken: list[Aim] = []
    for aim in aims:
        axis = aim.T_world_tool[:3, 2]
        alike = any(
            np.linalg.norm(aim.place_m - other.place_m) < apart_m
            and axis @ other.T_world_tool[:3, 2] > 0.97
            and (round_tool or _same_turn(aim, other))
            for other in taken
        )
        if not alike:
            taken.append(aim)
            yield aim


def _same_turn(aim: Aim, other: Aim) -> bool:
    return abs(float(aim.T_world_tool[:3, 0] @ other.T_world_tool[:3, 0])) > 0.9
