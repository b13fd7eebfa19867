"""The choice of a grip: the best reachable grip on the highest parts of the heap."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ....base.frames import inverse, transform_points
from ...grasp import DepthView, Doubt, patch_of_depth
from ..arm.obstacles import heap_obstacle, measured_heap, measured_points
from ..arm.robot import Joints, Obstacle, tool_touches
from ..arm.ways import Blocked, Load, Ways, WaySearch
from ..outcome import Outcome
from .aim import PLACES, Aim, Candidate, aims_by_pose, aims_in_depth, ranked, spread, trial_order
from .clock import Clock
from .ready import Ready

TABU_M = 0.015  # No grip this near to a failed grip is tried before a part near it is picked.
BLOCKED_M = 0.04  # Grips this near to an unreachable grip are tried last.
ALIKE_M = 0.008  # Of several similar grips within this distance, only one is planned.
LEAST_UP_M = 0.02
# standard deviation of an unknown part's centre of mass from its visible middle, along each axis
UNKNOWN_CENTER_M = 0.01
# A larger deviation from the part's surface, on a larger share of the area, is another part.
UNLIKE_M, UNLIKE_SHARE = 4e-3, 0.02
_MISSING = (
    "no detection",
    "no depth: too little was measured on every detection",
    "no pose: none fits the depth of its detection",
    "no grip: the tool fits nowhere on the parts",
    "no grip: all have less than the least score",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A grip with the arm's paths to the grip and away from it with the part."""

    aim: Aim
    ways: Ways


def choose(
    ready: Ready,
    view: DepthView,
    targets: Sequence[Candidate],
    q: Joints,
    tabu: Sequence[Float[np.ndarray, "3"]],
    blocked: Sequence[Float[np.ndarray, "3"]],
    *,
    seed: int,
    clock: Clock,
) -> Choice | Blocked:
    """Return a grip on one of the targets, or the reason why there is none.

    If the arm found no path to a grip, grips near it are tried last, because they are probably too
    far away or too steep as well.

    Args:
        q: the arm's present joint angles.
        tabu: places at which grips failed before.
        blocked: places to which no path was found before.
        seed: seed for places of grips and for path planning.
    """
    picking = ready.cell.config.picking
    why, sought = Blocked(outcome=Outcome.NOTHING_FOUND), list[Float[np.ndarray, "3"]]()
    heaps, posed, reached = _Heaps(ready, view), list[Candidate](), int(bool(targets))

    def aims() -> Iterator[Aim]:
        """Yield grips in the order of trial; grips near a place without a path come last."""
        nonlocal why, reached
        later = []
        for together in _together(ranked(targets, view, (*tabu, *blocked)), picking.targets):
            with clock("grips"):
                all_of_them = _aims(ready, together, view, seed, posed)
                candidates = [aim for aim in all_of_them if aim.score >= picking.least_score]
            reached = max(reached, 4 if all_of_them else 3 if posed else 2)
            fresh = [aim for aim in candidates if not _near(aim.place_m, tabu, TABU_M)]
            if candidates and not fresh and why.outcome is Outcome.NOTHING_FOUND:
                why = Blocked(outcome=Outcome.GIVEN_UP)
            for aim in spread(trial_order(fresh), ALIKE_M, round_tool=ready.tool.is_round):
                if _near(aim.place_m, (*blocked, *sought), BLOCKED_M):
                    later.append(aim)
                else:
                    yield aim
        yield from later

    for aim in aims():
        with clock("plan"):
            heap = heaps.of(aim)
            hit = _unlike(ready, view, aim) or _blocked_tool(ready, aim, heap)
            tried = hit or _ways(ready, q, aim, heap, seed)
        if isinstance(tried, Ways):
            return Choice(aim=aim, ways=tried)
        why = tried
        if hit is None:
            sought.append(aim.place_m)
        if len(sought) == picking.grips:
            break
    if why.outcome is Outcome.NOTHING_FOUND and not why.detail:
        why = replace(why, detail=_MISSING[reached])
    return replace(why, places_m=tuple(sought))


def _together(groups: Sequence[Sequence[Candidate]], count: int) -> Iterator[Sequence[Candidate]]:
    """Yield batches of up to `count` targets; each batch comes from one group."""
    for group in groups:
        for start in range(0, len(group), count):
            yield group[start : start + count]


def _near(
    place_m: Float[np.ndarray, "3"], others_m: Sequence[Float[np.ndarray, "3"]], within_m: float
) -> bool:
    return any(np.linalg.norm(place_m - other_m) < within_m for other_m in others_m)


def _aims(
    ready: Ready, targets: Sequence[Candidate], view: DepthView, seed: int, posed: list[Candidate]
) -> list[Aim]:
    """Return grips on some targets; append the targets with a known pose or surface to `posed`."""
    picking = ready.cell.config.picking
    lean_rad = float(np.radians(picking.most_lean_deg))
    search = ready.tool.in_depth
    if search is None or picking.knows == "part":
        return aims_by_pose(targets, view, ready.known, most_lean_rad=lean_rad, posed=posed)
    posed += targets
    doubt = Doubt(center_m=UNKNOWN_CENTER_M)
    one_part = picking.detector != "none"
    return aims_in_depth(
        targets,
        search(view=view, weight_n=ready.weight_n, doubt=doubt, most_lean_rad=lean_rad),
        one_part=one_part,
        count=PLACES * (1 if one_part else picking.targets),
        seed=seed,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Heap:
    obstacle: Obstacle
    highest_m: float


class _Heaps:
    """The measured heap as an obstacle; without the part that a tool is to enclose."""

    def __init__(self, ready: Ready, view: DepthView) -> None:
        self._ready, self._shape = ready, view.depth_m.shape
        self._points = measured_points(view.depth_m, view.camera, view.T_world_cam, ready.cell.box)
        self._heaps: dict[int, _Heap] = {}

    def of(self, aim: Aim) -> _Heap:
        own = self._ready.tool.reaches_round
        key = id(aim.target) if own else -1  # An id is unique because all targets stay in memory.
        if key not in self._heaps:
            without = aim.target.inside(self._shape) if own else None
            heap = measured_heap(self._points, without=without)
            self._heaps[key] = _Heap(
                obstacle=heap_obstacle(heap, self._ready.here.T_base_world),
                highest_m=float(heap.height_m.max()),
            )
        return self._heaps[key]


def _unlike(ready: Ready, view: DepthView, aim: Aim) -> Blocked | None:
    """Return a reason if the measured surface under a tool differs from the part, else None.

    If it differs, another part is on top of the part, or the pose is wrong.
    """
    ground_m = ready.tool.ground_m
    if ground_m is None or aim.T_cam_part is None:
        return None
    patch = patch_of_depth(
        view.depth_m,
        view.camera,
        inverse(view.T_world_cam) @ aim.T_world_tool,
        radius_m=ground_m,
        step_m=ground_m / 10,
    )
    under = np.linalg.norm(patch.node_m, axis=-1) <= ground_m
    height_m = patch.height_m[under]  # Comparisons with NaN are false below.
    if np.mean(height_m > UNLIKE_M) > UNLIKE_SHARE:
        detail = "an object is at the place of the cup"
        return Blocked(outcome=Outcome.COLLISION_SEEN, detail=detail)
    if np.mean(height_m < -UNLIKE_M) > UNLIKE_SHARE:
        detail = "the part is not at the place of the cup"
        return Blocked(outcome=Outcome.NOTHING_FOUND, detail=detail)
    return None


def _blocked_tool(ready: Ready, aim: Aim, heap: _Heap) -> Blocked | None:
    """Return a reason if the tool alone would collide at the grip, which is a fast check."""
    obstacles = (*ready.here.standing, heap.obstacle)
    tool = ready.tool.pieces(aim.opening_m)
    hit = tool_touches(tool, ready.here.flange(aim.T_world_tool), obstacles)
    if hit is None:
        return None
    return Blocked(outcome=Outcome.COLLISION_SEEN, detail=f"the tool would collide with {hit}")


def _ways(ready: Ready, q: Joints, aim: Aim, heap: _Heap, seed: int) -> Ways | Blocked:
    load = _load(ready, aim)
    highest_m = max(ready.cell.box.inner_m[2], heap.highest_m)
    clear_m = highest_m + load.below_m + ready.cell.config.picking.clear_m
    tool = ready.tool
    around = tool.reaches_round
    search = WaySearch(
        robot=ready.bare.mount(tool.pieces(aim.opening_m)) if around else ready.robot,
        here=ready.here,
        obstacles=(*ready.here.standing, heap.obstacle),
        up_m=max(clear_m - float(aim.place_m[2]), LEAST_UP_M),
        load=load,
        seed=seed,
    )
    return search.ways(q, aim.T_world_tool, round_tool=tool.is_round)


def _load(ready: Ready, aim: Aim) -> Load:
    """Return the extent of the part as seen from the tip.

    An unknown part is assumed to be as large as the largest part, but it cannot reach through the
    floor. If the tip is at height h above the floor and the tool leans by an angle a, then the part
    extends at most h cos a + size sin a below the tip when the tool is upright.
    """
    if aim.T_part_tool is None:
        size_m, axis = ready.load.below_m, aim.T_world_tool[:3, 2]
        deep_m = aim.place_m[2] * axis[2] + size_m * np.hypot(axis[0], axis[1])
        return replace(ready.load, below_m=float(np.clip(deep_m, LEAST_UP_M, size_m)))
    kind = 0 if aim.target.kind is None else aim.target.kind
    mesh = ready.cell.cell.scene.parts[kind].mesh
    corner = transform_points(inverse(aim.T_part_tool), mesh.vertices_m)
    return Load(
        below_m=max(float(-corner[:, 2].min()), LEAST_UP_M),
        aside_m=float(np.linalg.norm(corner[:, :2], axis=1).max()),
    )
