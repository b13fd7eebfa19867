"""Convex hulls as vertices and faces, and hulls with fewer vertices."""

from itertools import product

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold
from scipy.spatial import ConvexHull

Hull = tuple[np.ndarray, np.ndarray]
"""Vertices [m] (v, 3) in the part's frame and faces (f, 3), counter-clockwise from outside."""

_PLANE_DECIMALS = 12  # Planes [m] that differ less are one: they are of coplanar triangles.


def hull_of(vertices: Float[np.ndarray, "v 3"]) -> Hull:
    """The convex hull of points, faces turned outward."""
    hull = ConvexHull(vertices)
    kept = hull.vertices
    number = np.full(len(vertices), -1)
    number[kept] = np.arange(len(kept))
    faces, corner = number[hull.simplices], vertices[hull.simplices]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = np.einsum("fi,fi->f", normal, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices[kept], faces


def hull_solid(points: Float[np.ndarray, "v 3"]) -> Manifold:
    """The convex hull of points for boolean operations."""
    return Manifold.hull_points(points)


def height_m(
    point: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, " n"]:
    """Largest signed distance to the planes of the vertices' hull; negative inside."""
    plane = _planes(vertices)
    return (point @ plane[:, :3].T + plane[:, 3]).max(axis=1)


def _planes(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "p 4"]:
    return np.unique(ConvexHull(vertices).equations.round(_PLANE_DECIMALS), axis=0)


def thinned(vertices: Float[np.ndarray, "v 3"], limit_m: float) -> Float[np.ndarray, "k 3"]:
    """A subset of vertices whose hull leaves no other vertex farther outside than the limit.

    The engine's cost grows with each vertex. The farthest one outside of each face is added until
    none is outside.
    """
    directions = np.array(list(product((-1, 0, 1), repeat=3)))
    chosen = np.unique((vertices @ directions.T).argmax(axis=0))
    if np.linalg.matrix_rank(vertices[chosen] - vertices[chosen[0]], tol=1e-9) < 3:
        return vertices
    while True:
        plane = _planes(vertices[chosen])
        outside_m = vertices @ plane[:, :3].T + plane[:, 3]
        farthest = outside_m.argmax(axis=0)
        far = outside_m.max(axis=0) > limit_m
        more = np.union1d(chosen, farthest[far])
        if len(more) == len(chosen):
            return vertices[chosen]
        chosen = more
