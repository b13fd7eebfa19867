"""Points spread evenly over a part's surface."""

import numpy as np
from jaxtyping import Float

from ...base.kernels import kernel
from .part import Mesh

DENSITY = 8  # This many candidates are drawn for each point that is kept.
# R2 sequence: the plastic number's powers spread points evenly. Source: M. Roberts, "The
# Unreasonable Effectiveness of Quasirandom Sequences", 2018.
_PLASTIC = 1.32471795724474602596


def surface_points(
    mesh: Mesh, step_m: float, *, most: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return surface points about `step_m` apart, and the faces' outward normals there.

    Each new point is the candidate farthest from all earlier points, until no candidate is farther
    than the step, or there are `most` points (then the spacing is wider). The result is not random.

    Source: Y. Eldar et al., "The farthest point strategy for progressive image sampling", 1997.
    """
    area = mesh.face_area_m2
    wanted = int(np.clip(DENSITY * area.sum() / step_m**2, 200, DENSITY * most))
    point, face = _candidates(mesh, area, wanted)
    index = _farthest(point, step_m, most)
    return point[index], mesh.face_normal[face[index]]


def dense_points(
    mesh: Mesh, step_m: float, *, most: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return points faster than `surface_points`, with uneven spacing of `step_m` on average."""
    area_m2 = float(mesh.face_area_m2.sum())
    return spread_points(mesh, int(np.clip(area_m2 / step_m**2, 200, most)))


def spread_points(
    mesh: Mesh, count: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the given number of points with equal shares of the area, and outward normals."""
    point, face = _candidates(mesh, mesh.face_area_m2, count)
    return point, mesh.face_normal[face]


def _candidates(mesh: Mesh, area: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points at equal steps of area in the order of the faces, and even within each face."""
    total = np.cumsum(area)
    place = (np.arange(count) + 0.5) / count * total[-1]
    face = np.searchsorted(total, place).clip(0, len(area) - 1)
    k = np.arange(1, count + 1)
    u, v = (k / _PLASTIC) % 1, (k / _PLASTIC**2) % 1
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    corner = mesh.vertices_m[mesh.faces[face]].astype(np.float64)
    edge = corner[:, 1:] - corner[:, :1]
    return corner[:, 0] + u[:, None] * edge[:, 0] + v[:, None] * edge[:, 1], face


@kernel()
def _farthest(point, step_m, most):
    away2 = np.full(len(point), np.inf)
    index = np.empty(min(most, len(point)), np.int64)
    last, count = 0, 0
    while True:
        index[count] = last
        count += 1
        far, at = -1.0, 0
        for i in range(len(point)):
            x = point[i, 0] - point[last, 0]
            y = point[i, 1] - point[last, 1]
            z = point[i, 2] - point[last, 2]
            away2[i] = min(away2[i], x * x + y * y + z * z)
            if away2[i] > far:
                far, at = away2[i], i
        if count == len(index) or far < step_m * step_m:
            return index[:count]
        last = at
