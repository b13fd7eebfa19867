"""Errors of estimated poses by BOP's definitions.

Source: T. Hodan et al., "BOP Challenge 2020 on 6D Object Localization", ECCVW 2020, section 2.2;
"BOP Challenge 2024 on Model-Based and Model-Free 6D Object Pose Estimation" keeps the three errors
and their thresholds for localization.
"""

import numpy as np
from jaxtyping import Float

from ...base.kernels import kernel
from ...rig.optics import Optics

DELTA_M = 0.015  # In VSD, a surface is visible up to this distance behind the measured surface.
WIDTH_PX = 640.0  # MSPD is given in pixels of a picture with this width.


def rotation_translation(
    T_estimate: Float[np.ndarray, "4 4"],
    T_true: Float[np.ndarray, "4 4"],
    motions: Float[np.ndarray, "s 4 4"],
    *,
    middle_m: Float[np.ndarray, "3"] | None = None,
) -> tuple[float, float]:
    """Return the angle [rad] and distance [m] between poses, modulo the part's symmetry.

    Both values are for the symmetry motion with the smallest angle.

    Args:
        middle_m: point of the part at which the distance is measured; None for its origin.
    """
    alike = T_true @ motions
    R = np.einsum("ij,nik->njk", T_estimate[:3, :3], alike[:, :3, :3])
    # |R - 1| = 2 sqrt(2) sin(angle / 2) is accurate for small angles.
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

    It is `min over motions S of max over vertices x of |T_estimate x - T_true S x|`.
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

    The projection uses the camera matrix without lens distortion, as in BOP. The distance is
    infinite if a vertex is behind the camera at the estimated pose.
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

    The three maps contain distances from the camera's centre to a surface, not z; NaN for none. A
    surface is visible in a pixel if it is at most `DELTA_M` behind the measured surface, or if
    nothing was measured. The estimate also counts as visible where the true surface is visible. VSD
    is the share of wrong pixels among those with a visible surface: only one surface is visible, or
    the distances differ by at least the tolerance. VSD is 1 if no surface is visible.
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
    """Return the minimum over motions of the maximum vertex distance; skip poor motions early."""
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
