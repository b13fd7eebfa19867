"""A part's mesh as solids, without their cavities, and the convex hulls of points."""

from itertools import product

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold, OpType
from scipy.spatial import ConvexHull

from ...parts import Mesh
from ...parts.surface import Refusal, separate, shells_of

Points = Float[np.ndarray, "_ 3"]
Hull = tuple[np.ndarray, np.ndarray]
"""Vertices [m] (v, 3) in the part's frame and faces (f, 3), counter-clockwise from outside."""

# These shares of the tolerance are tried in turn until few enough faces are left.
SIMPLIFIED_BY = (0.1, 0.2, 0.3)
ENOUGH_FACES = 12_500
_PLANE_DECIMALS = 12  # Planes that agree to this many decimals [m] belong to coplanar triangles.


def bodies_of(mesh: Mesh) -> tuple[Manifold, ...]:
    """Return the separate bodies of a closed mesh, largest first, with cavities filled.

    Bodies that overlap or touch along a face become one; a body inside another is left out.

    Raises:
        ValueError: the mesh is not closed.
    """
    try:
        shells, _ = shells_of(mesh.vertices_m, mesh.faces)
    except Refusal as error:
        raise ValueError(str(error)) from error
    if not shells:
        raise ValueError("the mesh encloses no volume: turn its faces outward")
    joined = Manifold.batch_boolean(shells, OpType.Add) if len(shells) > 1 else shells[0]
    bodies = [body for body in separate(joined) if body.volume() > 0]
    return tuple(sorted(bodies, key=lambda body: -body.volume()))


def simplified(body: Manifold, tolerance_m: float) -> tuple[Manifold, float]:
    """Return the body with fewer faces, and how far its surface may have moved [m].

    The new vertices are a subset of the old vertices. The surface moves by 0.1 of the tolerance, or
    by up to 0.3 if more than `ENOUGH_FACES` would remain.
    """
    fewer, moved_m = body, 0.0
    for share in SIMPLIFIED_BY:
        if fewer.num_tri() <= ENOUGH_FACES:
            break
        moved_m = share * tolerance_m
        fewer = body.simplify(moved_m)
    return fewer, moved_m


def hull_of(vertices: Float[np.ndarray, "v 3"]) -> Hull:
    """Return the convex hull of points, with faces that point outward."""
    hull = ConvexHull(vertices)
    number = np.full(len(vertices), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces, corner = number[hull.simplices], vertices[hull.simplices]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = np.einsum("fi,fi->f", normal, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices[hull.vertices], faces


def height_m(
    point: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, " n"]:
    """Return each point's largest signed distance to the planes of a hull; negative inside."""
    plane = _planes(vertices)
    return (point @ plane[:, :3].T + plane[:, 3]).max(axis=1)


def _planes(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "p 4"]:
    return np.unique(ConvexHull(vertices).equations.round(_PLANE_DECIMALS), axis=0)


def thinned(vertices: Float[np.ndarray, "v 3"], limit_m: float) -> Float[np.ndarray, "k 3"]:
    """Return a subset of vertices whose hull leaves no other vertex farther outside than the limit.

    The engine's cost grows with each vertex. The farthest vertex outside each face is added until
    no vertex is outside.
    """
    directions = np.array(list(product((-1, 0, 1), repeat=3)))
    subset = np.unique((vertices @ directions.T).argmax(axis=0))
    if np.linalg.matrix_rank(vertices[subset] - vertices[subset[0]], tol=1e-9) < 3:
        return vertices
    while True:
        plane = _planes(vertices[subset])
        outside_m = vertices @ plane[:, :3].T + plane[:, 3]
        farthest = outside_m.argmax(axis=0)
        far = outside_m.max(axis=0) > limit_m
        more = np.union1d(subset, farthest[far])
        if len(more) == len(subset):
            return vertices[subset]
        subset = more
