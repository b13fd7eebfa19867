"""Registration of a scan's points to the faces of the bin: robust point-to-plane ICP.

Each step reduces the distances of points from the plane of the nearest face with a similar normal.
Tukey's weight excludes other objects. Its scale is common to all faces normal to one axis, so that
a precise floor does not exclude walls that are measured worse, and two walls farther apart than
stated share the error. The largest distance of a point that counts shrinks in each step.

Source: Chen & Medioni, "Object modelling by registration of multiple range images", 1992
(point-to-plane); Beaton & Tukey 1974 (weights).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from ...base.frames import rigid, transform_points
from ...base.robust import robust_sigma
from .shape import BinShape, height_over

FIRST_M, LAST_M, SHRINK = 0.04, 0.006, 0.75  # first and last limit of the distance; factor per step
_TUKEY = 4.685  # This many standard deviations give an efficiency of 95 %.
_LEAST_SIGMA_M = 1e-4


def register(
    cloud: Float[np.ndarray, "n 6"],
    T_world_cam: Float[np.ndarray, "4 4"],
    shape: BinShape,
    *,
    first_m: float = FIRST_M,
    iterations: int = 60,
    trust: Float[np.ndarray, " s"] | None = None,
) -> Float[np.ndarray, "4 4"]:
    """Return the pose, near a first pose, in which a cloud best fits the faces of the bin.

    Args:
        cloud: positions [m] and normals in the camera frame, as from `BinView.cloud`.
        T_world_cam: the first pose.
        first_m: largest distance of a point from its face in the first step.
        trust: for each surface, a factor on the weights of its points; None means 1.
    """
    T, reach_m = T_world_cam, first_m
    for _ in range(iterations):
        pairs = pairs_of(shape, T, cloud, reach_m, trust)
        step = _solved(*equations(shape, pairs))
        T = rigid(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3]) @ T
        settled = np.abs(step[:3]).max() < 1e-6 and np.abs(step[3:]).max() < 1e-6
        if reach_m == LAST_M and settled:
            break
        reach_m = max(LAST_M, SHRINK * reach_m)
    return T


@dataclass(frozen=True, slots=True)
class FacePairs:
    """Each point's face, distance from its plane, and weight [1 / m^2], which is 0 for outliers."""

    point: Float[np.ndarray, "n 3"]  # in the world frame
    face: Int[np.ndarray, " n"]
    height_m: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]


def pairs_of(
    shape: BinShape,
    T_world_cam: Float[np.ndarray, "4 4"],
    cloud: Float[np.ndarray, "n 6"],
    reach_m: float,
    trust: Float[np.ndarray, " s"] | None,
) -> FacePairs:
    point = transform_points(T_world_cam, cloud[:, :3])
    normal = cloud[:, 3:] @ T_world_cam[:3, :3].T
    face, distance_m = shape.nearest(point, normal, T_world_cam[:3, 3])
    height_m = height_over(shape, point, face)
    near = distance_m < reach_m
    weight = np.zeros(len(point))
    for axis in range(3):
        mine = near & (shape.axis[face] == axis)
        if not mine.any():
            continue
        spread_m = robust_sigma(height_m[mine])
        sigma_m = max(float(spread_m), _LEAST_SIGMA_M)
        cut_m = min(_TUKEY * sigma_m, reach_m)
        share = np.clip(1 - (height_m[mine] / cut_m) ** 2, 0, None) ** 2
        weight[mine] = share / sigma_m**2
    if trust is not None:
        weight *= trust[shape.surface[face]]
    return FacePairs(point, face, height_m, weight)


def equations(
    shape: BinShape, pairs: FacePairs
) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6"]]:
    """Return the normal equations for a small shift t and rotation w of the points in the world.

    A motion of a point by `t + w x p` changes its distance from a face by `n . t + (p x n) . w`.
    """
    used = pairs.weight > 0
    normal = shape.normal[pairs.face[used]]
    slope = np.concatenate([normal, np.cross(pairs.point[used], normal)], axis=1)
    weighted = slope * pairs.weight[used, None]
    return weighted.T @ slope, -weighted.T @ pairs.height_m[used]


def _solved(A: Float[np.ndarray, "6 6"], b: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """Solve for the motion; the weak damping only stops motion along undetermined freedoms."""
    damping = 1e-6 * max(float(np.diag(A).max()), 1.0)
    return np.linalg.solve(A + damping * np.diag([1.0, 1.0, 1.0, 0.01, 0.01, 0.01]), b)
