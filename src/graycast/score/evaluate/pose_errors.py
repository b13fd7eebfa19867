"""Errors of estimated poses as BOP defines them.

Source: T. Hodan et al., "BOP Challenge 2020 on 6D Object Localization", ECCVW 2020, section 2.2;
"BOP Challenge 2024 on Model-Based and Model-Free 6D Object Pose Estimation" keeps the three errors
and their thresholds for localization.
"""

import numpy as np
from jaxtyping import Float

from ...base.kernels import kernel
from ...rig.optics import Optics

DELTA_M = 0.015  # For VSD a surface is visible up to this far behind the measured one.
WIDTH_PX = 640.0  # MSPD is stated in pixels of a picture of this width.


def rotation_translation(
    T_estimate: Float[np.ndarray, "4 4"],
    T_true: Float[np.ndarray, "4 4"],
    motions: Float[np.ndarray, "s 4 4"],
    *,
    middle_m: Float[np.ndarray, "3"] | None = None,
) -> tuple[float, float]:
    """Return the angle [rad] and distance [m] between poses, modulo the part's symmetry.

    Of the motions that leave the part as it is, the one with the least angle is taken.

    Args:
        middle_m: the point of the part whose distance is meant; its origin if left out.
    """
    alike = T_true @ motions
    R = np.einsum("ij,nik->njk", T_estimate[:3, :3], alike[:, :3, :3])
    # |R - 1| = 2 sqrt(2) sin(angle / 2) gives small angles exactly.
    away = np.linalg.norm(R - np.eye(3), axis=(1, 2)) / np.sqrt(8.0)
    angle = 2 * np.arcsin(np.clip(away, 0, 1))
    best = int(np.argmin(angle))
    point = np.append(np.zeros(3) if middle_m is None else middle_m, 1.0)
    apart = (T_estimate - alike[best])[:3] @ point
    return float(angle[best]), float(np.linalg.norm(apart))


def mssd(
    T_estimate: Float[np.ndarray, "4 4"],
    T_true: Float[np.ndarray, "4 4"],
    vertices_m: Float[np.ndarray, "v 3"],
    motions: Float[np.ndarray, "s 4 4"],
) -> float:
    """Return the maximum symmetry-aware surface distance [m].

    `min over motions S of max over vertices x of |T_estimate x - T_true S x|`.
    """
    apart = T_estimate - T_true @ motions
    return _least_greatest(apart, np.ascontiguousarray(vertices_m, np.float64))


def mspd(
    T_estimate: Float[np.ndarray, "4 4"],
    T_true: Float[np.ndarray, "4 4"],
    vertices_m: Float[np.ndarray, "v 3"],
    motions: Float[np.ndarray, "s 4 4"],
    camera: Optics,
) -> float:
    """Return the maximum symmetry-aware projection distance, in pixels of a picture 640 wide.

    As BOP's camera matrix says, without lens distortion. Infinite if a vertex lies behind the
    camera at the estimated pose.
    """
    vertices = np.ascontiguousarray(vertices_m, np.float64)
    focal = np.array([camera.fx_px, camera.fy_px])
    mine = vertices @ T_estimate[:3, :3].T + T_estimate[:3, 3]
    if not (mine[:, 2] > 0).all():
        return float("inf")
    px = _least_greatest_px(mine[:, :2] / mine[:, 2:] * focal, T_true @ motions, vertices, focal)
    return px * WIDTH_PX / camera.width_px


def vsd(
    estimate_m: Float[np.ndarray, "h w"],
    true_m: Float[np.ndarray, "h w"],
    measured_m: Float[np.ndarray, "h w"],
    tolerances_m: Float[np.ndarray, " t"],
) -> Float[np.ndarray, " t"]:
    """Return the visible surface discrepancy, 0 to 1, for each tolerance.

    All three are distances from the camera's centre to the surface, not z; NaN where there is none.
    A surface is visible where it is not more than `DELTA_M` behind the measured one, or nothing was
    measured. The estimate is visible as well where the true surface is and the estimate has one.
    The error is the share, of the pixels where either is visible, of those where but one is or both
    differ by the tolerance or more. 1 where neither is visible.
    """
    visible = _visible(true_m, measured_m)
    mine = _visible(estimate_m, measured_m) | (visible & np.isfinite(estimate_m))
    both, either = visible & mine, visible | mine
    total = int(either.sum())
    if total == 0:
        return np.ones(len(tolerances_m))
    off = np.abs(estimate_m[both] - true_m[both])
    wrong = (off[None] >= tolerances_m[:, None]).sum(axis=1)
    return (wrong + total - int(both.sum())) / total


def _visible(surface_m: np.ndarray, measured_m: np.ndarray) -> np.ndarray:
    unknown = ~np.isfinite(measured_m)
    with np.errstate(invalid="ignore"):
        near = surface_m - measured_m <= DELTA_M
    return np.isfinite(surface_m) & (unknown | near)


@kernel(nogil=True, error_model="numpy")
def _least_greatest(apart, vertex):
    """Give up a motion once a vertex is farther than the best motion's farthest."""
    least = np.inf
    for s in range(len(apart)):
        A, greatest = apart[s], 0.0
        for v in range(len(vertex)):
            total = 0.0
            for i in range(3):
                x = A[i, 0] * vertex[v, 0] + A[i, 1] * vertex[v, 1] + A[i, 2] * vertex[v, 2]
                total += (x + A[i, 3]) ** 2
            greatest = max(greatest, total)
            if greatest >= least:
                break
        least = min(least, greatest)
    return np.sqrt(least)


@kernel(nogil=True, error_model="numpy")
def _least_greatest_px(mine, alike, vertex, focal):
    least = np.inf
    for s in range(len(alike)):
        T, greatest = alike[s], 0.0
        for v in range(len(vertex)):
            a, b, c = vertex[v, 0], vertex[v, 1], vertex[v, 2]
            z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
            x = (T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]) / z * focal[0] - mine[v, 0]
            y = (T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]) / z * focal[1] - mine[v, 1]
            greatest = max(greatest, x * x + y * y)
            if greatest >= least:
                break
        least = min(least, greatest)
    return np.sqrt(least)
