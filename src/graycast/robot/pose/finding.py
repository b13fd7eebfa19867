"""Search for a part's pose from a detection and a depth map."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...base import array_types as arrays
from ...base.public_value import public_value
from ...camera.crop import Crop, crop
from ...rig.optics import Optics
from ...world.parts.symmetry import nearest_member
from . import agreement
from .closest import OrientedPoints, settle
from .model import PoseModel
from .pairs import votes
from .trying import PoseTrial, Trials

WINDOW = 0.035  # half width of the window for normals, as a share of the diameter
REACH = 0.75  # The search uses depth up to this share of the diameter around a detection.
LEAST_POINTS = 30  # A detection must have this many points with normals.
SCENE_POINTS = 220  # Between 1 and 4 times this many points of a detection form pairs.
REFERENCES = 90  # number of these points that are references, which vote for poses
# If a detection is a bounding box without a mask, references come from the central ellipse with
# this share of the box's width and height.
CORE = 0.6
PEAKS = 6  # number of poses for which each reference point votes
ALIKE = 0.15  # Poses with key points within this share of the diameter count as one.
GUESSES = 200  # number of poses that ICP fits to the depth and that are rendered
ALIGNED = 16  # number of poses that are aligned to outlines
GATES = (0.12, 0.06, 0.03)  # gates of ICP as shares of the diameter, each used in `ROUNDS` rounds
ROUNDS = 5
SURE = 0.9  # Above this score, no further round of other orientations is tried.
TRIES = 3  # largest number of times that other orientations of the best pose are tried


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class PoseMatch:
    """A part's pose and its evidence: numbers of pixels on the rendered part, except `missed`.

    Attributes:
        T_cam_part: the pose; None if there was too little depth for a search.
        score: score of the pose, 0 to 1.
        visible: pixels that are measured on the part's surface.
        touching: pixels that are measured on the surface, but outside the detection.
        hidden: pixels that are measured in front of the part.
        contradicted: pixels that are measured behind the part.
        unknown: pixels without a measurement.
        missed: pixels of the detection that the part does not cover.
    """

    T_cam_part: arrays.FloatArray_4_4 | None
    score: float
    visible: int = 0
    touching: int = 0
    hidden: int = 0
    contradicted: int = 0
    unknown: int = 0
    missed: int = 0

    def __post_init__(self) -> None:
        if self.T_cam_part is not None:
            self.T_cam_part.flags.writeable = False


NOTHING = PoseMatch(T_cam_part=None, score=0.0)


def find_pose(
    model: PoseModel,
    depth_m: arrays.FloatArray_h_w,
    camera: Optics,
    mask: arrays.BoolArray_h_w,
    *,
    near: arrays.FloatArray_4_4 | None = None,
) -> PoseMatch:
    """Find the pose of a part whose visible outline is known.

    If the symmetry given to `pose_model` makes several poses equivalent, return the pose nearest to
    `near`, or without `near` the standard pose (`world.parts.symmetry.nearest_member`).

    Args:
        depth_m: z [m], NaN where the scanner measured nothing.
        mask: the part's visible pixels, including those without depth.
        near: a pose, such as the one in the previous picture; only its orientation matters.

    Raises:
        ValueError: depth, camera and mask have different sizes.
    """
    return _match(model, depth_m, camera, mask, tight=True, near=near)


def find_pose_in_box(
    model: PoseModel,
    depth_m: Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"],
    camera: Optics,
    box_px: Float[np.ndarray, "4"],
) -> PoseMatch:
    """Find the pose of the part in a box, which is [x, y, columns, rows] as in `Detections`."""
    inside = np.zeros(depth_m.shape, dtype=bool)
    left, top = np.maximum(np.rint(box_px[:2]).astype(int), 0)
    right, bottom = np.maximum(np.rint(box_px[:2] + box_px[2:]).astype(int), 0)
    inside[top:bottom, left:right] = True
    return _match(model, depth_m, camera, inside, tight=False, near=None)


def find_poses(
    model: PoseModel,
    depth_m: arrays.FloatArray_h_w,
    camera: Optics,
    masks: Sequence[arrays.BoolArray_h_w] | arrays.BoolArray_n_h_w,
    *,
    threads: int = 1,
) -> list[PoseMatch]:
    """Find the poses of several instances of a part in one image, independently of each other.

    The slow steps are compiled and run in parallel threads. The result does not depend on the
    number of threads.
    """
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda mask: find_pose(model, depth_m, camera, mask), masks))


def _match(
    model: PoseModel,
    depth_m: np.ndarray,
    camera: Optics,
    inside: Bool[np.ndarray, "h w"],
    *,
    tight: bool,
    near: Float[np.ndarray, "4 4"] | None,
) -> PoseMatch:
    if depth_m.shape != (camera.height_px, camera.width_px) or inside.shape != depth_m.shape:
        raise ValueError(
            f"the depth is {depth_m.shape[1]} x {depth_m.shape[0]} px, the mask {inside.shape[1]} "
            f"x {inside.shape[0]}, the camera {camera.width_px} x {camera.height_px}: give depth, "
            "mask and camera of one picture"
        )
    patch = crop(
        depth_m,
        camera,
        inside,
        tight=tight,
        reach_m=REACH * model.diameter_m,
        window_m=WINDOW * model.diameter_m,
    )
    if patch is None:
        return NOTHING
    scene = _scene_points(patch)
    if len(scene.point) < LEAST_POINTS:
        return NOTHING
    guesses = _guesses(model, patch, scene)
    settle(guesses, scene, model.surface, np.array(GATES) * model.diameter_m, ROUNDS)
    best = _best(model, patch, guesses)
    return _estimate(best, nearest_member(best.T, model.symmetry, near=near))


def _scene_points(patch: Crop) -> OrientedPoints:
    """Return measured points and normals of the detection, evenly distributed over its pixels."""
    usable = patch.inside & np.isfinite(patch.smooth)
    i, j = np.nonzero(usable)
    index = np.linspace(0, len(i) - 1, min(SCENE_POINTS, len(i))).astype(int)
    stride = max(int(np.sqrt(len(i) / SCENE_POINTS)), 1)
    even = np.flatnonzero((i % stride == 0) & (j % stride == 0))
    index = even if len(even) >= LEAST_POINTS else index
    i, j = i[index], j[index]
    z = patch.smooth[i, j]
    point = np.column_stack([patch.ray[i, j] * z[:, None], z])
    return OrientedPoints(point=point, normal=np.ascontiguousarray(patch.normal[i, j]))


def _guesses(model: PoseModel, patch: Crop, scene: OrientedPoints) -> np.ndarray:
    """Return poses by votes: the best pose of each group of similar poses, best group first."""
    point, references = scene.point, np.arange(len(scene.point))
    if not patch.tight:
        i, j = np.nonzero(patch.inside)
        middle = patch.ray[(i.min() + i.max()) // 2, (j.min() + j.max()) // 2]
        low, high = patch.ray[i.min(), j.min()], patch.ray[i.max(), j.max()]
        half = np.maximum((high - low) / 2, 1e-9)
        away = (point[:, :2] / point[:, 2:] - middle) / half
        core = np.flatnonzero(np.square(away).sum(axis=1) < CORE**2)
        references = core if len(core) >= 10 else references
    index = np.linspace(0, len(references) - 1, min(REFERENCES, len(references))).astype(int)
    T, weight = votes(scene, references[index], model.points, model.pairs, PEAKS)
    return _bundled(model, T, weight)[:GUESSES]


def _bundled(model: PoseModel, T: np.ndarray, weight: np.ndarray) -> np.ndarray:
    order = np.argsort(-weight, kind="stable")
    T, weight = T[order], weight[order]
    heads: list[int] = []
    total = np.zeros(len(T))
    place = np.einsum("nij,sjk,pk->nspi", T[:, :3, :3], model.alike[:, :3, :3], model.key_m)
    shift = np.einsum("nij,sj->nsi", T[:, :3, :3], model.alike[:, :3, 3]) + T[:, None, :3, 3]
    place = place + shift[:, :, None]
    for i in range(len(T)):
        if heads:
            apart = np.abs(place[heads, 0][:, None] - place[i][None]).max(axis=(2, 3)).min(axis=1)
            near = int(np.argmin(apart))
            if apart[near] < ALIKE * model.diameter_m:
                total[heads[near]] += weight[i]
                continue
        heads.append(i)
        total[i] = weight[i]
    best = sorted(heads, key=lambda head: -total[head])
    return np.ascontiguousarray(T[best])


def _best(model: PoseModel, patch: Crop, guesses: Float[np.ndarray, "n 4 4"]) -> PoseTrial:
    """Return the best pose: score and align the guesses, then try rotations of the best one."""
    trials = Trials(model, patch)
    first = np.array([trials.judge(T).worth for T in guesses])
    both = (
        trials.judge(T)
        for k in np.argsort(-first, kind="stable")[:ALIGNED]
        for T in (trials.align(guesses[k]), guesses[k])
    )
    best = max(both, key=lambda trial: trial.worth)  # If scores are equal, max takes the first.
    for _ in range(TRIES):
        before = best
        for turn in model.turns[1:]:
            T = trials.placed(before.T @ turn)
            if T is not None:
                best = max(best, trials.judge(trials.align(T)), key=lambda trial: trial.worth)
        if best is before or best.worth > SURE:
            break
    return best


def _estimate(best: PoseTrial, T_cam_part: Float[np.ndarray, "4 4"]) -> PoseMatch:
    number = best.number
    return PoseMatch(
        T_cam_part=T_cam_part,
        score=float(np.clip(best.worth, 0, 1)),
        visible=int(number[agreement.VISIBLE]),
        touching=int(number[agreement.TOUCHING]),
        hidden=int(number[agreement.HIDDEN]),
        contradicted=int(number[agreement.CONTRADICTED]),
        unknown=int(number[agreement.UNKNOWN]),
        missed=int(number[agreement.MISSED] + number[agreement.MISSED_UNKNOWN]),
    )
