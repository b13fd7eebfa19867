"""Measure the distance between convex hulls and the surface that they approximate.

The hulls' union may reach out of the part by at most the error (so gaps that are wider than twice
the error stay open), and may miss the surface by at most the error (no corner is lost).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold, OpType
from scipy.spatial import cKDTree

from ....base.kernels import kernel
from ...parts import Mesh
from ...parts.surface import surface_of
from .solid import Hull, bodies_of, height_m

TOLERANCE_M = 0.5e-3
TOLERANCE_OF_DIAGONAL = 0.005  # With 0.5 mm, as for screws, a bottle would need too many hulls.
MIDDLE_TOLERANCE = (
    0.01,
    1e-3,
)  # With 0.5 mm instead of 0.8 mm, a bracket drops a third more slowly.
SAMPLES = 20_000  # Number of points on a part's surface.
LID_SAMPLES = 1000  # Number of points on the surface of the volume that a hull adds.
NEAR = 48  # Distance is measured to the triangles of this many nearest samples.
AT_A_TIME = 32  # Exact distances are computed for this many points at once.
STEEP = 0.5  # Outside points have a direction with a larger cosine to the normal.
# An added volume is only round-off if its mean thickness is below this share of the tolerance.
_NOTHING = 1e-4


def tolerance_m(mesh: Mesh) -> float:
    """Return the largest allowed distance between the hulls' union and a mesh's surface [m].

    It is 0.5 mm up to a bounding box diagonal of 50 mm, 1 % of the diagonal up to 100 mm, 1 mm up
    to 200 mm, and then 0.5 % of the diagonal.
    """
    diagonal_m = float(np.linalg.norm(mesh.extent_m))
    share, most_m = MIDDLE_TOLERANCE
    return max(TOLERANCE_M, min(share * diagonal_m, most_m), TOLERANCE_OF_DIAGONAL * diagonal_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshSamples:
    """Triangles, and points sampled on them uniformly by area, for distance queries."""

    corner: Float[np.ndarray, "f 3 3"]
    point: Float[np.ndarray, "n 3"]
    face: Int[np.ndarray, " n"]  # Index of each point's triangle.
    normal: Float[np.ndarray, "f 3"]
    tree: cKDTree

    def farthest_m(self, point: Float[np.ndarray, "m 3"]) -> float:
        """Return the points' largest distance to the surface; 0 without points.

        Only the triangles of the `NEAR` nearest samples count, so the result may be too large.
        """
        return self._farthest_m(point, self.tree.query(point)[0])

    def outside_m(self, point: Float[np.ndarray, "m 3"]) -> float:
        """Return the largest distance of points that are certainly outside; 0 without such points.

        A point is certainly outside if it is in front of the nearest sample's triangle rather than
        to the side of it.
        """
        apart, near = self.tree.query(point)
        before = np.einsum("ni,ni->n", point - self.point[near], self.normal[self.face[near]])
        steep = before > STEEP * apart
        return self._farthest_m(point[steep], apart[steep])

    def _farthest_m(
        self, point: Float[np.ndarray, "m 3"], most_m: Float[np.ndarray, " m"]
    ) -> float:
        """Return the largest distance; the upper bounds `most_m` save most computations."""
        order = np.argsort(-most_m)
        farthest, done = 0.0, 0
        while done < len(point) and farthest < most_m[order[done]]:
            block = order[done : done + AT_A_TIME]
            _, near = self.tree.query(point[block], k=min(NEAR, len(self.face)))
            faces = self.face[near.reshape(len(block), -1)]
            farthest = max(farthest, float(_nearest_m(point[block], faces, self.corner).max()))
            done += len(block)
        return farthest


def surface_samples(solid: Manifold) -> MeshSamples:
    """Return a solid's triangles with sample points, which help to find the nearest triangles."""
    point, face, corner = spread(solid, SAMPLES)
    cross = _cross(corner)
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), np.finfo(float).tiny)
    return MeshSamples(corner=corner, point=point, face=face, normal=normal, tree=cKDTree(point))


def spread(
    solid: Manifold, count: int
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, "f 3 3"]]:
    """Return points (random by area, and centroids), their triangles' indices, and all triangles.

    The seed is fixed, so the result depends on the solid alone.
    """
    vertices, faces = surface_of(solid)
    corner = vertices[faces]
    rng = np.random.default_rng(0)
    share = np.linalg.norm(_cross(corner), axis=1).cumsum()
    face = np.searchsorted(share, share[-1] * rng.random(count)).clip(max=len(corner) - 1)
    u, v = rng.random((2, count))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u)[:, None], np.where(over, 1 - v, v)[:, None]
    a, b, c = corner[face, 0], corner[face, 1], corner[face, 2]
    middles = np.arange(len(corner))[:: 1 + len(corner) // count]
    point = np.vstack([a + u * (b - a) + v * (c - a), corner[middles].mean(axis=1)])
    return point, np.concatenate([face, middles]), corner


def filled_m(hull: Manifold, solid: Manifold, surface: MeshSamples) -> float:
    """Return how far a hull reaches out of a solid: its largest distance outside it [m]."""
    filling = hull - solid
    if filling.is_empty():
        return 0.0
    area = filling.surface_area()
    if not area or 2 * filling.volume() / area < _NOTHING * TOLERANCE_M:
        return 0.0
    return surface.farthest_m(spread(filling, LID_SAMPLES)[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Decomposition:
    """A mesh's hulls, their errors, and their tolerance [m].

    `filled_m` is how far hulls reach out of the part, `lost_m` how far it reaches out of them.
    """

    hulls: tuple[Hull, ...]
    filled_m: float
    lost_m: float
    tolerance_m: float

    @property
    def worst_m(self) -> float:
        return max(self.filled_m, self.lost_m)

    @property
    def coarse(self) -> bool:
        """Whether the error exceeds the tolerance, as for a mesh with too much detail."""
        return self.worst_m > self.tolerance_m


def measure(mesh: Mesh, hulls: tuple[Hull, ...]) -> Decomposition:
    """Return hulls with their largest errors, outside and inside the mesh."""
    solid = Manifold.batch_boolean(bodies_of(mesh), OpType.Add)
    surface = surface_samples(solid)
    filled = max(filled_m(Manifold.hull_points(corners), solid, surface) for corners, _ in hulls)
    outside_m = np.full(len(surface.point), np.inf)
    for vertices, _ in hulls:
        outside_m = np.minimum(outside_m, height_m(surface.point, vertices))
    return Decomposition(
        hulls=hulls,
        filled_m=filled,
        lost_m=max(0.0, float(outside_m.max())),
        tolerance_m=tolerance_m(mesh),
    )


def _cross(corner: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


@kernel(error_model="numpy")  # Degenerate triangles then raise no error.
def _nearest_m(point, faces, corner):
    """Return the distance of each point to the nearest of its faces.

    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.1.5 (the regions of a
    triangle, by barycentric coordinates).
    """
    nearest = np.empty(len(point))
    for i in range(len(point)):
        least = np.inf
        for face in faces[i]:
            a, b, c = corner[face, 0], corner[face, 1], corner[face, 2]
            ab, ac, ap = b - a, c - a, point[i] - a
            d1, d2 = np.dot(ab, ap), np.dot(ac, ap)
            bp, cp = point[i] - b, point[i] - c
            d3, d4 = np.dot(ab, bp), np.dot(ac, bp)
            d5, d6 = np.dot(ab, cp), np.dot(ac, cp)
            va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
            if d1 <= 0 and d2 <= 0:
                away = ap
            elif d3 >= 0 and d4 <= d3:
                away = bp
            elif d6 >= 0 and d5 <= d6:
                away = cp
            elif vc <= 0 and d1 >= 0 and d3 <= 0:
                away = ap - d1 / (d1 - d3) * ab
            elif vb <= 0 and d2 >= 0 and d6 <= 0:
                away = ap - d2 / (d2 - d6) * ac
            elif va <= 0 and d4 >= d3 and d5 >= d6:
                away = bp - (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
            else:
                away = ap - (vb * ab + vc * ac) / (va + vb + vc)
            square = np.dot(away, away)
            if square < least:
                least = square
        nearest[i] = np.sqrt(least)
    return nearest
