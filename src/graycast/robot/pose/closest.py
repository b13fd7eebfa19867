"""The nearest surface point for any point near a part, and ICP with these point pairs."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from ...base.kernels import kernel

CELLS = 60  # number of grid cells along the diameter
BEYOND = 0.2  # margin of the grid around the part's box, as a share of the diameter
ALIKE = 0.5  # least cosine between the normals of corresponding points
DAMPING = 1e-3  # damping of undetermined directions, as a share of the mean curvature


class OrientedPoints(NamedTuple):
    """Points of a surface and the surface normals at these points."""

    point: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]


class Closest(NamedTuple):
    """A grid of cells around a part, each with the index of its nearest surface point.

    Attributes:
        points: points of the surface, in the part's frame.
        low_m: the centre of the first cell.
        cell_m: the width of a cell.
        nearest: index in `points` of the point nearest to the cell's centre.
    """

    points: OrientedPoints
    low_m: Float[np.ndarray, "3"]
    cell_m: float
    nearest: Int[np.ndarray, "x y z"]


def closest(points: OrientedPoints, diameter_m: float) -> Closest:
    """Return the lookup grid for a surface that is sampled by dense points."""
    cell_m = diameter_m / CELLS
    low = points.point.min(axis=0) - BEYOND * diameter_m
    size = np.ceil((points.point.max(axis=0) + BEYOND * diameter_m - low) / cell_m).astype(int) + 1
    axes = [low[k] + cell_m * np.arange(size[k]) for k in range(3)]
    middles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    nearest = cKDTree(points.point).query(middles.reshape(-1, 3))[1].astype(np.int32)
    return Closest(points=points, low_m=low, cell_m=cell_m, nearest=nearest.reshape(size))


@kernel(nogil=True, error_model="numpy")
def settle(T, scene, surface, gates_m, rounds):
    """Move poses in place by point-to-plane ICP; return each pose's share of matched points.

    Matched points are within the gate; `rounds` steps are done with each gate, widest first.
    Source: Y. Chen, G. Medioni, "Object modelling by registration of multiple range images", 1992.
    """
    shares = np.zeros(len(T))
    for k in range(len(T)):
        for gate in gates_m:
            for _ in range(rounds):
                shares[k] = _round(T[k], scene, surface, gate)
                if shares[k] == 0:
                    break
    return shares


@kernel(nogil=True, error_model="numpy")
def _round(T, scene, surface, gate):
    """Do one ICP step; return the share of points matched within the gate, or 0 if too few."""
    point, normal = scene.point, scene.normal
    low, cell, nearest = surface.low_m, surface.cell_m, surface.nearest
    A, b = np.zeros((6, 6)), np.zeros(6)
    row, p, n = np.empty(6), np.empty(3), np.empty(3)
    nx, ny, nz = nearest.shape
    count = 0
    for i in range(len(point)):
        for j in range(3):
            p[j] = n[j] = 0.0
            for k in range(3):
                p[j] += T[k, j] * (point[i, k] - T[k, 3])
                n[j] += T[k, j] * normal[i, k]
        x = math.floor((p[0] - low[0]) / cell + 0.5)
        y = math.floor((p[1] - low[1]) / cell + 0.5)
        z = math.floor((p[2] - low[2]) / cell + 0.5)
        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
            continue
        at = nearest[x, y, z]
        m, q = surface.points.normal[at], surface.points.point[at]
        if n[0] * m[0] + n[1] * m[1] + n[2] * m[2] < ALIKE:
            continue
        away2 = (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2
        if away2 > gate * gate:
            continue
        off = m[0] * (p[0] - q[0]) + m[1] * (p[1] - q[1]) + m[2] * (p[2] - q[2])
        weight = (1 - away2 / (gate * gate)) ** 2  # Tukey's biweight
        fill_row(row, p, m[0], m[1], m[2])
        add_row(A, b, row, off, weight)
        count += 1
    if count < 6:
        return 0.0
    # The scene moves by -step in the part's frame, so the part moves by +step in its own.
    turn_by(T, solved(A, b))
    return count / len(point)


@kernel(nogil=True, error_model="numpy")
def fill_row(row, p, mx, my, mz):
    """Fill a row with the derivative of p along m with respect to a small rotation and shift."""
    row[0], row[1], row[2] = p[1] * mz - p[2] * my, p[2] * mx - p[0] * mz, p[0] * my - p[1] * mx
    row[3], row[4], row[5] = mx, my, mz


@kernel(nogil=True, error_model="numpy")
def add_row(A, b, row, off, weight):
    for j in range(6):
        b[j] += weight * row[j] * off
        for k in range(j + 1):
            A[j, k] += weight * row[j] * row[k]


@kernel(nogil=True, error_model="numpy")
def solved(A, b):
    """Return the damped solution of A x = b with scaled unknowns; A has only its lower half."""
    scale = np.empty(6)
    turn = (A[0, 0] + A[1, 1] + A[2, 2]) / 3 + 1e-30
    shift = (A[3, 3] + A[4, 4] + A[5, 5]) / 3 + 1e-30
    for j in range(6):
        scale[j] = 1 / math.sqrt(turn if j < 3 else shift)
    M, v = np.empty((6, 6)), np.empty(6)
    for j in range(6):
        v[j] = b[j] * scale[j]
        for k in range(6):
            M[j, k] = (A[j, k] if k <= j else A[k, j]) * scale[j] * scale[k]
        M[j, j] += DAMPING
    step = np.linalg.solve(M, v)
    return step * scale


@kernel(nogil=True, error_model="numpy")
def turn_by(T, step):
    """Multiply T in place by a rotation (step[:3]) and shift (step[3:]) in the part's frame."""
    x, y, z = step[0], step[1], step[2]
    angle = math.sqrt(x * x + y * y + z * z)
    R = np.eye(3)
    if angle > 1e-12:
        x, y, z = x / angle, y / angle, z / angle
        c, s = math.cos(angle), math.sin(angle)
        R[0, 0], R[0, 1], R[0, 2] = (
            c + x * x * (1 - c),
            x * y * (1 - c) - z * s,
            x * z * (1 - c) + y * s,
        )
        R[1, 0], R[1, 1], R[1, 2] = (
            y * x * (1 - c) + z * s,
            c + y * y * (1 - c),
            y * z * (1 - c) - x * s,
        )
        R[2, 0], R[2, 1], R[2, 2] = (
            z * x * (1 - c) - y * s,
            z * y * (1 - c) + x * s,
            c + z * z * (1 - c),
        )
    old = T.copy()
    for i in range(3):
        for j in range(3):
            T[i, j] = old[i, 0] * R[0, j] + old[i, 1] * R[1, j] + old[i, 2] * R[2, j]
        T[i, 3] = old[i, 3] + old[i, 0] * step[3] + old[i, 1] * step[4] + old[i, 2] * step[5]
