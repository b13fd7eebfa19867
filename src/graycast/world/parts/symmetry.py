"""Symmetries as sets of rigid motions, and the detection of a shape's symmetry."""

from collections.abc import Iterable
from itertools import permutations, product

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from ...base.frames import rigid
from .part import Mesh, Symmetry
from .sampling import dense_points

STEP = 0.01  # From one step to the next, a point moves at most by this share of the diameter (BOP).
SHAPE_STEP = 0.04  # Shapes are compared at points that are this share of the diameter apart.
SHAPE_TOLERANCE = 0.01  # A symmetry moves the surface by less than this share of the diameter.
LEFT = 0.98  # After a symmetry operation, at least this share of the points is on the surface.
FOLDS = (2, 3, 4, 5, 6, 8)  # Rotations by a full turn divided by these numbers are tried.
MOST_MOTIONS = 120  # The icosahedron, the solid with the most rotations, has 60.
MANY = 36  # A body of revolution is symmetric under a full turn divided by this.
# These weights apply when one of the equal poses of a symmetric part is chosen without a reference.
# With equal weights, the two poses of an upside-down part with half-turn symmetry would be equally
# near to the camera's axes, and noise would decide.
AXIS_WEIGHT = (3.0, 2.0, 1.0)


def motions(symmetry: Symmetry) -> Float[np.ndarray, "n 4 4"]:
    """Return all motions of a symmetry, the identity first; continuous symmetries in equal steps.

    A continuous symmetry becomes `ceil(pi / STEP)` turns, so that a point at half a diameter from
    the axis moves by at most `2 * STEP * diameter / 2` from one turn to the next. Discrete motions
    and turns are combined.

    Source: T. Hodan et al., "BOP Challenge 2020 on 6D Object Localization", ECCVW 2020, and the
    `max_sym_disc_step` of 0.01 stated there (section 2.3).
    """
    discrete = [np.eye(4), *symmetry.discrete]
    turns = int(np.ceil(np.pi / STEP))
    continuous = [
        _turn(np.array(axis), np.array(offset), 2 * np.pi * k / turns)
        for axis, offset in symmetry.continuous
        for k in range(turns)
    ] or [np.eye(4)]
    return np.stack([turn @ motion for motion in discrete for turn in continuous])


def nearest_member(
    T: Float[np.ndarray, "4 4"], symmetry: Symmetry, *, near: Float[np.ndarray, "4 4"] | None = None
) -> Float[np.ndarray, "4 4"]:
    """Return the pose nearest to a reference orientation among all poses that look the same.

    If S are the motions of the symmetry, the pose T S is returned whose rotation R has the greatest
    `trace(W.T R)`. If W is the reference's rotation, this gives the least angle to it. Without a
    reference, W is `diag(AXIS_WEIGHT)`, so the part's axes point along the frame's axes.

    Leaves out: continuous axes after the first, which only a ball has. If two poses are equally
    near, noise decides; without a reference, this happens only in rare poses.

    Args:
        near: a pose of the same part in the same frame, such as the previous one.
    """
    wanted = np.diag(AXIS_WEIGHT) if near is None else near[:3, :3]
    M = wanted.T @ T[:3, :3]
    best, most = T, -np.inf
    for flip in (np.eye(4), *symmetry.discrete):
        member = flip
        for axis, offset in symmetry.continuous[:1]:
            member = _turn(np.array(axis), np.array(offset), _best_turn(axis, flip, M)) @ flip
        gain = float(np.trace(M @ member[:3, :3]))
        if gain > most:  # The first of several equal values wins.
            best, most = T @ member, gain
    return best


def _best_turn(
    axis: tuple[float, float, float],
    flip: Float[np.ndarray, "4 4"],
    M: Float[np.ndarray, "3 3"],
) -> float:
    """Return the angle t of the turn about the axis that makes `trace(M turn(t) flip)` greatest.

    With N = flip M and the unit vector a, Rodrigues' formula gives the trace as a constant and
    `cos t (tr N - a N a) + sin t tr([a]x N)`.
    """
    a = np.array(axis) / np.linalg.norm(axis)
    N = flip[:3, :3] @ M
    return float(np.arctan2(np.trace(_cross(a) @ N), np.trace(N) - a @ N @ a))


def shape_symmetry(mesh: Mesh) -> Symmetry:
    """Return the proper rotations that leave a shape unchanged; print and colour are ignored.

    Axes through the middle of the bounding box are tried: the axes of the box, and those that halve
    the angles between the box's axes. Symmetry about other axes is not detected.

    Returns:
        One continuous axis and the half turns that reverse it, or the discrete rotations.
    """
    diameter_m = float(np.linalg.norm(mesh.extent_m))
    point, normal = dense_points(mesh, SHAPE_STEP * diameter_m, most=3000)
    dense, dense_normal = dense_points(mesh, SHAPE_STEP / 6 * diameter_m, most=40_000)
    tree, middle = cKDTree(dense), mesh.bounds_m.mean(axis=0)

    def share_left(T: Float[np.ndarray, "4 4"], every: int) -> float:
        moved, turned = point[::every] @ T[:3, :3].T + T[:3, 3], normal[::every] @ T[:3, :3].T
        near = tree.query(moved, k=8)[1]
        away = np.abs(np.einsum("nki,nki->nk", dense[near] - moved[:, None], dense_normal[near]))
        alike = np.einsum("nki,ni->nk", dense_normal[near], turned) > 0.8
        least = np.where(alike, away, np.inf).min(axis=1)
        return float(np.mean(least < SHAPE_TOLERANCE * diameter_m))

    def leaves(T: Float[np.ndarray, "4 4"]) -> bool:
        return share_left(T, 16) > 0.9 and share_left(T, 1) > LEFT

    for axis in np.eye(3):
        if all(leaves(_turn(axis, middle, 2 * np.pi * k / MANY)) for k in (1, 5, 7, 11, 18)):
            across = np.roll(axis, 1)
            flip = _turn(across, middle, np.pi)
            continuous = ((tuple(axis.tolist()), tuple(middle.tolist())),)
            return Symmetry(discrete=(flip,) if leaves(flip) else (), continuous=continuous)
    discrete: list[np.ndarray] = []
    for T in _candidates(middle):
        if not any(np.allclose(T, other, atol=1e-9) for other in discrete) and leaves(T):
            discrete.append(T)
    return Symmetry(discrete=tuple(discrete))


def turns_together(
    turns: Iterable[tuple[tuple[float, float, float], tuple[float, float, float], int]],
) -> tuple[Float[np.ndarray, "4 4"], ...]:
    """Return all motions except the identity that combinations of turns make.

    Args:
        turns: for each turn the axis, a point on it [m], and the number of turns in a circle.

    Raises:
        ValueError: there are more than `MOST_MOTIONS`, for example because axes do not intersect.
    """
    steps = [
        _turn(np.array(axis), np.array(point_m), 2 * np.pi / fold) for axis, point_m, fold in turns
    ]
    motions = [np.eye(4)]
    for motion in motions:  # The list grows during the loop, until no step gives a new motion.
        for step in steps:
            next_motion = step @ motion
            if not any(np.allclose(next_motion, other, atol=1e-6) for other in motions):
                motions.append(next_motion)
        if len(motions) > MOST_MOTIONS:
            raise ValueError(
                f"the turns together make more than {MOST_MOTIONS} motions: check that their axes "
                "meet in one point, or give a continuous axis"
            )
    return tuple(motions[1:])


def joined(first: Symmetry, second: Symmetry) -> Symmetry:
    """Join two symmetries; the second's continuous axes apply only if the first has no such axes.

    A body has at most one motion for each rotation, so motions are compared by rotation alone.
    """
    both = [*first.discrete]
    for T in second.discrete:
        if not any(np.allclose(T[:3, :3], S[:3, :3], atol=1e-3) for S in both):
            both.append(T)
    return Symmetry(discrete=tuple(both), continuous=first.continuous or second.continuous)


def _candidates(middle: Float[np.ndarray, "3"]):
    """Return turns about the box's axes, and all rotations that permute these axes."""
    for axis, fold in product(np.eye(3), FOLDS):
        for k in range(1, fold):
            yield _turn(axis, middle, 2 * np.pi * k / fold)
    for R in axis_rotations()[1:]:
        yield _about(R, middle)


def axis_rotations() -> Float[np.ndarray, "24 3 3"]:
    """Return the rotations that map the coordinate axes to each other, the identity first."""
    rotations = []
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[np.arange(3), order] = sign
            if np.linalg.det(R) > 0:
                rotations.append(R)
    return np.stack(rotations)


def _turn(
    axis: Float[np.ndarray, "3"], offset: Float[np.ndarray, "3"], angle_rad: float
) -> Float[np.ndarray, "4 4"]:
    """Return a turn about an axis through a point, by Rodrigues' formula."""
    K = _cross(axis / np.linalg.norm(axis))
    R = np.eye(3) + np.sin(angle_rad) * K + (1 - np.cos(angle_rad)) * K @ K
    return _about(R, offset)


def _cross(a: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the matrix of the vector product with a."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def _about(R: Float[np.ndarray, "3 3"], point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    return rigid(R, point - R @ point)
