"""The bin's pose from depth: iterated closest faces, robust against what is not the bin.

Every point is drawn to the plane of the nearest face whose normal is about its own (point-to-plane
ICP; the box is analytic, so nothing is sampled). Tukey's weight takes clutter out; its scale is
that of all faces across one axis, so that a precise floor does not throw out walls that are
measured worse, and two walls farther apart than stated share the error. What counts shrinks from
coarse to fine.

Leaves out: walls that lean, bend or bulge, rounded edges, and errors of the scanner that all
points share; residuals by face show them.

Source: Chen & Medioni, "Object modelling by registration of multiple range images", 1992
(point-to-plane); Beaton & Tukey 1974 (weights).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from ..errors import GraycastError
from ..frames import axis_rotation, inverse, rigid, transform_points
from .box import NO_FACE, OpenBox, cast, height_over, nearest_face
from .edges import hold_by_edges
from .reading import View
from .start import evidence, start_poses

FREEDOMS = ("x", "y", "z", "about x", "about y", "about z")  # of the bin, in its own frame
_FIRST_M, _LAST_M, _SHRINK = 0.04, 0.006, 0.75  # how far a point may lie from its face
_TUKEY, _MAD_SIGMA = 4.685, 1.4826  # 95 % efficiency; a normal law's sigma over its MAD
_LEAST_SIGMA_M = 1e-4
_LEAST_INLIERS = 60  # points of a face that hold a degree of freedom
_FINE_M = 0.005  # of the evidence that picks one of the starts
_STARTS, _FINALISTS = 10, 3  # poses begun with on each plane, and followed to the end
_LEAST_AGREEING = 0.35  # of what is measured where the bin should be
_LOOSE_M, _LOOSE_RAD = 0.4e-3, np.radians(0.15)


@dataclass(frozen=True, slots=True, kw_only=True)
class FaceFit:
    """How well one face agrees with what was measured on it.

    `seen_px` pixels should show the face; `measured` is the share of them with depth, `inliers`
    that with depth of this face. The rest is about signed distances of inliers from its plane,
    positive on the visible side; NaN where there are none.
    """

    name: str
    seen_px: int
    measured: float
    inliers: float
    median_m: float
    rms_m: float
    p95_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFit:
    """A pose with what speaks for it.

    `sigma` is the standard deviation of each of `FREEDOMS` [m, rad], of the noise that the
    residuals show, as if points were independent; of `by_edges`, which no face holds well, it says
    nothing: they follow from where rim and floor end. `loose` names those that nothing holds.
    """

    T_world_cam: Float[np.ndarray, "4 4"]
    faces: tuple[FaceFit, ...]
    rms_m: float
    median_m: float  # of absolute residuals
    p95_m: float
    inlier_share: float  # of all measured points in the bin's own space
    agreeing: float  # of what is measured where the floor should be seen, or the walls if less
    sigma: Float[np.ndarray, "6"]
    by_edges: tuple[str, ...]
    loose: tuple[str, ...]

    def __post_init__(self) -> None:
        self.T_world_cam.flags.writeable = False
        self.sigma.flags.writeable = False


def find_pose(
    views: Sequence[View], box: OpenBox, *, azimuth_rad: float, seed: int
) -> Float[np.ndarray, "4 4"]:
    """`T_world_cam` from all views together, without a hint.

    A box looks the same after half a turn, a square one after a quarter: of these poses it is
    the one whose azimuth (of the camera's x axis in the world) is nearest to `azimuth_rad`.

    Raises:
        GraycastError: nothing in the views looks like the bin.
    """
    starts = []
    for view in views:
        starts += start_poses(box, *view.grid(64), each=_STARTS, seed=seed)
    if not starts:
        raise GraycastError("no flat surface is in the depth that could be the bin's floor")
    few = np.concatenate([view.cloud(1500 // len(views)) for view in views])
    coarse = _best_first(box, few, [register(few, T, box, iterations=20) for T in starts])
    quarter = rigid(axis_rotation("z", np.pi / 2), np.zeros(3))
    finalists = [turned for T in coarse[:_FINALISTS] for turned in (T, quarter @ T)]
    cloud = np.concatenate([view.cloud() for view in views])
    best = _best_first(box, few, [register(cloud, T, box) for T in finalists])[0]
    return _turned(best, box, azimuth_rad)


def _best_first(
    box: OpenBox, cloud: Float[np.ndarray, "n 6"], poses: list[Float[np.ndarray, "4 4"]]
) -> list[Float[np.ndarray, "4 4"]]:
    """Ordered by evidence times what agrees: beside a bin stands much table, but no wall."""
    ray, depth_m = cloud[:, :3] / cloud[:, 2:3], cloud[:, 2]
    score = np.maximum(evidence(box, np.stack(poses), ray, depth_m, _FINE_M), 0)
    score *= [_agreeing(box, [_seen(box, T, ray, depth_m)]) for T in poses]
    return [poses[i] for i in np.argsort(-score, kind="stable")]


def register(
    cloud: Float[np.ndarray, "n 6"],
    T_world_cam: Float[np.ndarray, "4 4"],
    box: OpenBox,
    *,
    first_m: float = _FIRST_M,
    iterations: int = 60,
    trust: Float[np.ndarray, "f"] | None = None,
) -> Float[np.ndarray, "4 4"]:
    """The pose near a first one in which a cloud lies best on the box's faces.

    Args:
        cloud: places [m] and normals in the camera frame, as of `View.cloud`.
        T_world_cam: the first pose.
        first_m: how far from its face a point may be at first.
        trust: a factor on the weights of each face's points; None: 1.
    """
    T, reach_m = T_world_cam, first_m
    for _ in range(iterations):
        pairs = _pairs(box, T, cloud, reach_m, trust)
        step = _solved(*_equations(box, pairs))
        T = _moved(T, step)
        settled = np.abs(step[:3]).max() < 1e-6 and np.abs(step[3:]).max() < 1e-6
        if reach_m == _LAST_M and settled:
            break
        reach_m = max(_LAST_M, _SHRINK * reach_m)
    return T


def settle(views: Sequence[View], box: OpenBox, T_world_cam: Float[np.ndarray, "4 4"]) -> PoseFit:
    """The pose near a first one with what speaks for it: by faces, and by edges where these fail.

    Raises:
        GraycastError: too little of what is measured agrees with the bin.
    """
    cloud = np.concatenate([view.cloud() for view in views])
    fit = judge(views, box, register(cloud, T_world_cam, box, first_m=3 * _LAST_M))
    # What little is measured of a wall in shadow is often wrong.
    trust = np.array([face.inliers for face in fit.faces])
    T = register(cloud, fit.T_world_cam, box, first_m=_LAST_M, trust=trust)
    fit = judge(views, box, T, trust=trust)
    T, held = hold_by_edges(views, box, fit.T_world_cam, fit.loose, fit.rms_m)
    loose = tuple(name for name in fit.loose if name not in held)
    return replace(judge(views, box, T, trust=trust), by_edges=held, loose=loose)


def judge(
    views: Sequence[View],
    box: OpenBox,
    T_world_cam: Float[np.ndarray, "4 4"],
    *,
    trust: Float[np.ndarray, "f"] | None = None,
) -> PoseFit:
    """What residuals and geometry say about a pose; `trust` as of `register`.

    Raises:
        GraycastError: too little of what is measured agrees with the bin.
    """
    cloud = np.concatenate([view.cloud() for view in views])
    pairs = _pairs(box, T_world_cam, cloud, _LAST_M, trust)
    inlier = pairs.weight > 0
    residual_m = pairs.height_m[inlier]
    grids = [view.grid(512) for view in views]
    seen = [_seen(box, T_world_cam, ray.reshape(-1, 3), z.ravel()) for ray, z in grids]
    agreeing = _agreeing(box, seen)
    if agreeing < _LEAST_AGREEING:
        raise GraycastError(
            f"no bin of {' x '.join(f'{1e3 * size:.0f}' for size in box.inner_m)} mm inside is in "
            f"the depth: at best {agreeing:.0%} of it agrees; are the size, the scale of the depth "
            "and the intrinsics right, and are floor and walls in view?"
        )
    space = _in_bin(box, pairs.point)
    sigma = _deviations(_equations(box, pairs)[0])
    return PoseFit(
        T_world_cam=T_world_cam.copy(),
        faces=tuple(_face_fit(box, f, seen, pairs) for f in range(len(box.names))),
        rms_m=float(np.sqrt((residual_m**2).mean())),
        median_m=float(np.median(np.abs(residual_m))),
        p95_m=float(np.percentile(np.abs(residual_m), 95)),
        inlier_share=_share((space & inlier).sum(), space.sum()),
        agreeing=agreeing,
        sigma=sigma,
        by_edges=(),
        loose=_loose(box, pairs, sigma),
    )


def difference(
    T_world_cam: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]
) -> tuple[float, float]:
    """How far two fits are apart: places of the bin's origin [m], and the angle [rad]."""
    T_a, T_b = inverse(T_world_cam), inverse(other)
    turn = Rotation.from_matrix(T_a[:3, :3].T @ T_b[:3, :3]).magnitude()
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])), float(turn)


# --- one iteration -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Pairs:
    """The face of each point, its height over it, and its weight [1 / m^2], 0 of what is not it."""

    point: Float[np.ndarray, "n 3"]  # in the world
    face: Int[np.ndarray, "n"]
    height_m: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]


def _pairs(
    box: OpenBox,
    T_world_cam: Float[np.ndarray, "4 4"],
    cloud: Float[np.ndarray, "n 6"],
    reach_m: float,
    trust: Float[np.ndarray, "f"] | None,
) -> _Pairs:
    point = transform_points(T_world_cam, cloud[:, :3])
    normal = cloud[:, 3:] @ T_world_cam[:3, :3].T
    face, distance_m = nearest_face(box, point, normal, box.facing(T_world_cam[:3, 3]))
    height_m = height_over(box, point, face)
    near = distance_m < reach_m
    weight = np.zeros(len(point))
    for axis in range(3):
        mine = near & (box.axis[face] == axis)
        if not mine.any():
            continue
        spread_m = _MAD_SIGMA * np.median(np.abs(height_m[mine]))
        sigma_m = max(float(spread_m), _LEAST_SIGMA_M)
        cut_m = min(_TUKEY * sigma_m, reach_m)
        share = np.clip(1 - (height_m[mine] / cut_m) ** 2, 0, None) ** 2
        weight[mine] = share / sigma_m**2
    if trust is not None:
        weight *= trust[face]
    return _Pairs(point, face, height_m, weight)


def _equations(
    box: OpenBox, pairs: _Pairs
) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6"]]:
    """Normal equations of a small motion (shift, turn) of the points in the world.

    A point moves by `t + w x p`, so its height over a face of normal n by `n . t + (p x n) . w`.
    """
    used = pairs.weight > 0
    normal = box.normal[pairs.face[used]]
    slope = np.concatenate([normal, np.cross(pairs.point[used], normal)], axis=1)
    weighted = slope * pairs.weight[used, None]
    return weighted.T @ slope, -weighted.T @ pairs.height_m[used]


def _solved(A: Float[np.ndarray, "6 6"], b: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """The motion, damped so little that only what nothing holds stays where it is."""
    damping = 1e-6 * max(float(np.diag(A).max()), 1.0)
    return np.linalg.solve(A + damping * np.diag([1.0, 1.0, 1.0, 0.01, 0.01, 0.01]), b)


def _moved(T: Float[np.ndarray, "4 4"], step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    return rigid(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3]) @ T


def _turned(
    T: Float[np.ndarray, "4 4"], box: OpenBox, azimuth_rad: float
) -> Float[np.ndarray, "4 4"]:
    def off(turned: np.ndarray) -> float:
        azimuth = np.arctan2(turned[1, 0], turned[0, 0])
        return abs((azimuth - azimuth_rad + np.pi) % (2 * np.pi) - np.pi)

    angles = 2 * np.pi / box.turns * np.arange(box.turns)
    alike = [rigid(axis_rotation("z", float(a)), np.zeros(3)) @ T for a in angles]
    return min(alike, key=off)


# --- what a pose is worth ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Seen:
    """Of a view's pixels: the face that each should show, and what was measured there."""

    face: Int[np.ndarray, "n"]
    measured: Bool[np.ndarray, "n"]
    agrees: Bool[np.ndarray, "n"]


def _seen(
    box: OpenBox,
    T_world_cam: Float[np.ndarray, "4 4"],
    ray: Float[np.ndarray, "n 3"],
    depth_m: Float[np.ndarray, "n"],
) -> _Seen:
    face, _ = cast(box, T_world_cam, ray)
    measured = np.isfinite(depth_m) & (face != NO_FACE)
    agrees = np.zeros(len(face), dtype=bool)
    point = transform_points(T_world_cam, ray[measured] * depth_m[measured][:, None])
    agrees[measured] = np.abs(height_over(box, point, face[measured])) < _LAST_M
    return _Seen(face, measured, agrees)


def _agreeing(box: OpenBox, seen: Sequence[_Seen]) -> float:
    """The lower share of two, of what is measured where the floor should be, and where the walls.

    A table will do for a floor, but has no walls; a box on its side has walls, but no floor.
    """
    shares = []
    for floor in (True, False):
        mine = [s.measured & (box.is_floor[s.face] == floor) for s in seen]
        agrees = sum((s.agrees & m).sum() for s, m in zip(seen, mine, strict=True))
        shares.append(_share(agrees, sum(m.sum() for m in mine)))
    return min(shares)


def _face_fit(box: OpenBox, f: int, seen: Sequence[_Seen], pairs: _Pairs) -> FaceFit:
    mine = [s.face == f for s in seen]
    seen_px = int(sum(m.sum() for m in mine))
    measured = sum((s.measured & m).sum() for s, m in zip(seen, mine, strict=True))
    agrees = sum((s.agrees & m).sum() for s, m in zip(seen, mine, strict=True))
    height_m = pairs.height_m[(pairs.face == f) & (pairs.weight > 0)]
    size_m = np.abs(height_m) if len(height_m) else np.array([np.nan])
    return FaceFit(
        name=box.names[f],
        seen_px=seen_px,
        measured=_share(measured, seen_px),
        inliers=_share(agrees, seen_px),
        median_m=float(np.median(height_m)) if len(height_m) else np.nan,
        rms_m=float(np.sqrt((size_m**2).mean())),
        p95_m=float(np.percentile(size_m, 95)),
    )


def _in_bin(box: OpenBox, point: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
    margin = np.array([0.01, 0.01, 0.02])
    low, high = box.low_m.min(axis=0) - margin, box.high_m.max(axis=0) + margin
    return ((point > low) & (point < high)).all(axis=1)


def _deviations(A: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6"]:
    """Square roots of the covariance's diagonal; inf where nothing holds."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-12))
    value, vector = np.linalg.eigh(A / np.outer(size, size))
    held = value > 1e-9
    variance = (vector[:, held] ** 2 / value[held]).sum(axis=1)
    variance[(vector[:, ~held] ** 2 > 1e-6).any(axis=1)] = np.inf
    return np.sqrt(variance) / size


def _loose(box: OpenBox, pairs: _Pairs, sigma: Float[np.ndarray, "6"]) -> tuple[str, ...]:
    """Places along an axis need a face across it; all six need a deviation that is small."""
    used = pairs.weight > 0
    along = np.bincount(box.axis[pairs.face[used]], minlength=3)
    limit = np.array([_LOOSE_M] * 3 + [_LOOSE_RAD] * 3)
    loose = ~(sigma < limit)
    loose[:3] |= along < _LEAST_INLIERS
    return tuple(name for name, is_loose in zip(FREEDOMS, loose, strict=True) if is_loose)


def _share(part: int | np.integer, whole: int | np.integer) -> float:
    return float(part / whole) if whole else 0.0
