"""Fit of a bin's pose to depth, with residuals for each surface and undetermined freedoms.

Leaves out: walls that lean, bend or bulge, rounded edges, and scanner errors common to all points.
The residuals of the surfaces show such errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from ...base.errors import GraycastError
from ...base.frames import axis_rotation, inverse, rigid, transform_points
from .bin_views import BinView, Grid
from .box import OpenBox, stand_in
from .registration import LAST_M, FacePairs, equations, pairs_of, register
from .shape import NO_FACE, BinShape, height_over
from .start import start_poses

FREEDOMS = ("x", "y", "z", "about x", "about y", "about z")  # in the bin's frame
_LEAST_INLIERS = 60  # Fewer points on faces normal to an axis do not determine the shift along it.
_FINE_M = 0.005  # tolerance of the votes that compare poses
_SEARCH_PX = 64
_NEARLY_SQUARE = 0.8  # Above this ratio of width to length, the pose turned by 90 degrees is tried.
_STARTS, _FINALISTS = 10, 4  # start poses per plane; poses that are refined to the end
_LEAST_AGREEING = 0.35  # least share of the depth on the bin's pixels that agrees with the bin
SEARCHED = ("x", "y", "about z")
_FIRST_M, _LAST_M = 4e-3, 0.05e-3
_LEVER_M = 0.2  # lever arm that converts a step [m] into an angle [rad]
_ACROSS_PX = 512
_LEAST_TOLERANCE_M = 0.003
_TRY_M, _LEAST_VOTES = 2e-3, 25.0  # A determined pose loses this many votes if shifted by _TRY_M.
_AROUND_M = np.array([0.01, 0.01, 0.02])  # The bin's space extends this far beyond the bin.
_LOOSE_M, _LOOSE_RAD = 0.4e-3, np.radians(0.15)


@dataclass(frozen=True, slots=True, kw_only=True)
class FaceFit:
    """Agreement of one surface of the bin with the measured depth.

    `seen_px` counts the pixels that should show the surface. Of these, the share `measured` has
    depth, and the share `inliers` has depth that agrees with the surface. The lengths describe the
    inliers' distances from the plane, positive on the visible side; NaN without inliers.
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
    """A pose with its residuals and uncertainty.

    `sigma` is the standard deviation of each of `FREEDOMS` [m, rad], estimated from the residuals
    under the assumption of independent points. It does not apply to the freedoms in `by_edges`,
    which only the edges of rim and floor determine. Nothing determines the freedoms in `loose`.
    """

    T_world_cam: Float[np.ndarray, "4 4"]
    faces: tuple[FaceFit, ...]
    rms_m: float
    median_m: float  # median absolute residual
    p95_m: float
    inlier_share: float  # share of inliers among all measured points in and near the bin
    agreeing: float  # lower of the shares of agreeing depth on the floor and on the walls
    sigma: Float[np.ndarray, "6"]
    by_edges: tuple[str, ...]
    loose: tuple[str, ...]

    def __post_init__(self) -> None:
        self.T_world_cam.flags.writeable = False
        self.sigma.flags.writeable = False


def find_pose(
    views: Sequence[BinView],
    shape: BinShape,
    *,
    azimuth_rad: float,
    seed: int,
    stated: Float[np.ndarray, "4 4"] | None = None,
) -> PoseFit:
    """Find the pose from all views together.

    Fits of the shape begin at the rough pose `stated`, or else at likely poses of a box with the
    same inner size. A box looks the same after a turn of 180 degrees, and a square box after 90.
    Among these poses, the result has the azimuth of the camera's x axis in the world that is
    nearest to `azimuth_rad`.

    Raises:
        GraycastError: no surface in the views agrees with the bin.
    """
    box, starts = stand_in(shape), [] if stated is None else [stated]
    grids = [view.grid(_SEARCH_PX) for view in views]
    for grid in grids if stated is None else ():
        starts += start_poses(box, grid, each=_STARTS, seed=seed)
    if not starts:
        raise GraycastError("the depth has no flat surface that could be the bin's floor")
    few = np.concatenate([view.cloud(1500 // len(views)) for view in views])
    coarse = _best_first(shape, grids, [register(few, T, shape, iterations=20) for T in starts])
    cloud = np.concatenate([view.cloud() for view in views])
    best = _best_first(shape, grids, [register(cloud, T, shape) for T in coarse[:_FINALISTS]])[0]
    candidates = [best]
    if box.turns < 4 and min(box.inner_m[:2]) > _NEARLY_SQUARE * max(box.inner_m[:2]):
        quarter = rigid(axis_rotation("z", np.pi / 2), np.zeros(3))
        candidates.append(register(cloud, quarter @ best, shape))
    # Only the ends of the bin distinguish length from width, so `settle` also compares edges.
    turned = [_turned(T, box, azimuth_rad) for T in candidates]
    return _best_settled(views, shape, grids, turned)


def _best_settled(
    views: Sequence[BinView],
    shape: BinShape,
    grids: Sequence[Grid],
    candidates: Sequence[Float[np.ndarray, "4 4"]],
) -> PoseFit:
    """Refine all candidates and return the best; raise the first error if all fail."""
    fits, refusals = [], []
    for T in candidates:
        try:
            fits.append(settle(views, shape, T))
        except GraycastError as refusal:
            refusals.append(refusal)
    if not fits:
        raise refusals[0]
    best = _best_first(shape, grids, [fit.T_world_cam for fit in fits])[0]
    return next(fit for fit in fits if fit.T_world_cam is best)


def _best_first(
    shape: BinShape, grids: Sequence[Grid], poses: list[Float[np.ndarray, "4 4"]]
) -> list[Float[np.ndarray, "4 4"]]:
    """Sort poses by votes times agreement, best first; a table agrees less, as it has no walls."""
    score = np.maximum(sum(shape.votes(np.stack(poses), grid, _FINE_M) for grid in grids), 0)
    score *= [_agreeing(shape, _match(shape, T, grids)) for T in poses]
    return [poses[i] for i in np.argsort(-score, kind="stable")]


def settle(
    views: Sequence[BinView], shape: BinShape, T_world_cam: Float[np.ndarray, "4 4"]
) -> PoseFit:
    """Refine a pose by faces, and by edges where faces do not determine it.

    Raises:
        GraycastError: too little of the measured depth agrees with the bin.
    """
    cloud = np.concatenate([view.cloud() for view in views])
    fit = judge(views, shape, register(cloud, T_world_cam, shape, first_m=3 * LAST_M))
    # The few measured points of a wall in shadow are often wrong, so they get lower weights.
    trust = np.array([face.inliers for face in fit.faces])
    T = register(cloud, fit.T_world_cam, shape, first_m=LAST_M, trust=trust)
    fit = judge(views, shape, T, trust=trust)
    T, by_edges = hold_by_edges(views, shape, fit.T_world_cam, fit.loose, fit.rms_m)
    loose = tuple(name for name in fit.loose if name not in by_edges)
    return replace(judge(views, shape, T, trust=trust), by_edges=by_edges, loose=loose)


def hold_by_edges(
    views: Sequence[BinView],
    shape: BinShape,
    T_world_cam: Float[np.ndarray, "4 4"],
    loose: Sequence[str],
    noise_m: float,
) -> tuple[Float[np.ndarray, "4 4"], tuple[str, ...]]:
    """Move a pose along loose freedoms to the most votes; return it and the determined freedoms.

    If walls are missing, in shadow or hardly visible, faces do not determine the position along an
    axis or the turn about z. Edges of rim and floor still do, to a fraction of a pixel, because a
    shifted pose predicts the rim where depth shows none, and the reverse. The method is a pattern
    search, because votes count pixels and have no derivative.

    Args:
        loose: the degrees of freedom to find; only those in `SEARCHED` are changed.
        noise_m: RMS of the residuals.
    """
    free = [name for name in SEARCHED if name in loose]
    if not free:
        return T_world_cam, ()
    grids = [view.grid(_ACROSS_PX) for view in views]
    tolerance_m = max(_LEAST_TOLERANCE_M, 4 * noise_m)

    def votes(poses: list[np.ndarray]) -> Float[np.ndarray, " p"]:
        each = (shape.votes(np.stack(poses), grid, tolerance_m) for grid in grids)
        return sum(each, start=np.zeros(len(poses)))

    best, step_m = T_world_cam, _FIRST_M
    most = votes([best])[0]
    while step_m > _LAST_M:
        tried = [_beside(best, name, s * step_m) for name in free for s in (1, -1)]
        score = votes(tried)
        if score.max() > most:
            best, most = tried[int(score.argmax())], score.max()
        else:
            step_m /= 2
    beside = votes([_beside(best, name, s * _TRY_M) for name in free for s in (1, -1)])
    cost = most - beside.reshape(len(free), 2).max(axis=1)
    determined = tuple(name for name, lost in zip(free, cost, strict=True) if lost >= _LEAST_VOTES)
    return best, determined


def _beside(
    T_world_cam: Float[np.ndarray, "4 4"], name: str, step_m: float
) -> Float[np.ndarray, "4 4"]:
    if name == "about z":
        return rigid(axis_rotation("z", step_m / _LEVER_M), np.zeros(3)) @ T_world_cam
    return rigid(np.eye(3), step_m * np.eye(3)["xy".index(name)]) @ T_world_cam


def judge(
    views: Sequence[BinView],
    shape: BinShape,
    T_world_cam: Float[np.ndarray, "4 4"],
    *,
    trust: Float[np.ndarray, " s"] | None = None,
) -> PoseFit:
    """Compute the residuals and the uncertainty of a pose; `register` explains `trust`.

    Raises:
        GraycastError: too little of the measured depth agrees with the bin.
    """
    cloud = np.concatenate([view.cloud() for view in views])
    pairs = pairs_of(shape, T_world_cam, cloud, LAST_M, trust)
    inlier = pairs.weight > 0
    residual_m = pairs.height_m[inlier]
    match = _match(shape, T_world_cam, [view.grid(_ACROSS_PX) for view in views])
    agreeing = _agreeing(shape, match)
    if agreeing < _LEAST_AGREEING:
        size = " x ".join(f"{1e3 * length:.0f}" for length in shape.inner_m)
        raise GraycastError(
            f"no bin of {size} mm inside is in the depth: at best {agreeing:.0%} of it agrees; "
            "check the size, the scale of the depth and the intrinsics, and that floor and walls "
            "are in view"
        )
    low, high = shape.bounds_m
    space = ((pairs.point > low - _AROUND_M) & (pairs.point < high + _AROUND_M)).all(axis=1)
    sigma = _deviations(equations(shape, pairs)[0])
    return PoseFit(
        T_world_cam=T_world_cam.copy(),
        faces=tuple(_face_fit(shape, k, match, pairs) for k in range(len(shape.names))),
        rms_m=float(np.sqrt((residual_m**2).mean())),
        median_m=float(np.median(np.abs(residual_m))),
        p95_m=float(np.percentile(np.abs(residual_m), 95)),
        inlier_share=_share((space & inlier).sum(), space.sum()),
        agreeing=agreeing,
        sigma=sigma,
        by_edges=(),
        loose=_loose(shape, pairs, sigma),
    )


def difference(
    T_world_cam: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]
) -> tuple[float, float]:
    """Return the distance [m] between the bin's origins in two fits, and their angle [rad]."""
    T_a, T_b = inverse(T_world_cam), inverse(other)
    turn = Rotation.from_matrix(T_a[:3, :3].T @ T_b[:3, :3]).magnitude()
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])), float(turn)


def _turned(
    T: Float[np.ndarray, "4 4"], box: OpenBox, azimuth_rad: float
) -> Float[np.ndarray, "4 4"]:
    def off(turned: np.ndarray) -> float:
        azimuth = np.arctan2(turned[1, 0], turned[0, 0])
        return abs((azimuth - azimuth_rad + np.pi) % (2 * np.pi) - np.pi)

    angles = 2 * np.pi / box.turns * np.arange(box.turns)
    alike = [rigid(axis_rotation("z", float(a)), np.zeros(3)) @ T for a in angles]
    return min(alike, key=off)


@dataclass(frozen=True, slots=True)
class _Match:
    """The expected surface at each pixel of all views, and whether depth is there and agrees."""

    surface: Int[np.ndarray, " n"]
    measured: Bool[np.ndarray, " n"]
    agrees: Bool[np.ndarray, " n"]


def _match(shape: BinShape, T_world_cam: Float[np.ndarray, "4 4"], grids: Sequence[Grid]) -> _Match:
    face = np.concatenate([shape.cast(T_world_cam, grid)[0].ravel() for grid in grids])
    point_m = np.concatenate([grid.point_m.reshape(-1, 3) for grid in grids])
    measured = np.isfinite(point_m[:, 2]) & (face != NO_FACE)
    agrees = np.zeros(len(face), dtype=bool)
    point = transform_points(T_world_cam, point_m[measured])
    agrees[measured] = np.abs(height_over(shape, point, face[measured])) < LAST_M
    surface = np.where(face == NO_FACE, NO_FACE, shape.surface[face])
    return _Match(surface, measured, agrees)


def _agreeing(shape: BinShape, match: _Match) -> float:
    """Return the share of measured depth that agrees, on the floor or on the walls (the lower).

    A table can look like a floor but has no walls; a box on its side has walls but no floor.
    """
    shares, is_of_floor = [], np.array(shape.names) == "floor"
    for floor in (True, False):
        mine = match.measured & (is_of_floor[match.surface] == floor)
        shares.append(_share((match.agrees & mine).sum(), mine.sum()))
    return min(shares)


def _face_fit(shape: BinShape, k: int, match: _Match, pairs: FacePairs) -> FaceFit:
    mine = match.surface == k
    pixels = mine.sum()
    height_m = pairs.height_m[(shape.surface[pairs.face] == k) & (pairs.weight > 0)]
    size_m = np.abs(height_m) if len(height_m) else np.array([np.nan])
    return FaceFit(
        name=shape.names[k],
        seen_px=int(pixels),
        measured=_share((match.measured & mine).sum(), pixels),
        inliers=_share((match.agrees & mine).sum(), pixels),
        median_m=float(np.median(height_m)) if len(height_m) else np.nan,
        rms_m=float(np.sqrt((size_m**2).mean())),
        p95_m=float(np.percentile(size_m, 95)),
    )


def _deviations(A: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6"]:
    """Return the standard deviations of the freedoms; infinite if nothing determines a freedom."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-12))
    value, vector = np.linalg.eigh(A / np.outer(size, size))
    determined = value > 1e-9
    variance = (vector[:, determined] ** 2 / value[determined]).sum(axis=1)
    variance[(vector[:, ~determined] ** 2 > 1e-6).any(axis=1)] = np.inf
    return np.sqrt(variance) / size


def _loose(shape: BinShape, pairs: FacePairs, sigma: Float[np.ndarray, "6"]) -> tuple[str, ...]:
    """Return the freedoms with a large deviation or with few points on faces normal to an axis."""
    used = pairs.weight > 0
    along = np.bincount(shape.axis[pairs.face[used]], minlength=3)
    limit = np.array([_LOOSE_M] * 3 + [_LOOSE_RAD] * 3)
    loose = ~(sigma < limit)
    loose[:3] |= along < _LEAST_INLIERS
    return tuple(name for name, is_loose in zip(FREEDOMS, loose, strict=True) if is_loose)


def _share(part: int | np.integer, whole: int | np.integer) -> float:
    return float(part / whole) if whole else 0.0
