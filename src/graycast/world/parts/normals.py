"""Shading normals of a triangle mesh: smooth where it is curved, sharp at its edges."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def crease_normals(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], crease_rad: float
) -> Float[np.ndarray, "f 3 3"]:
    """Return the unit normal of every face corner, averaged over smoothly joined faces.

    Two faces are smoothly joined if they share an edge with no third face, and their normals differ
    by at most `crease_rad`. A corner's normal is the mean over the faces around its vertex that a
    chain of such edges reaches, weighted by face area times corner angle: the angle makes the
    result independent of how a quad is cut in two, and the area keeps large flat faces flat next to
    a finely rounded edge (G. Thuermer & C. Wuethrich, "Computing vertex normals from polygonal
    facets", J. Graphics Tools 3(1), 1998, with the area added).

    Returns:
        Unit normals; a corner with no face of positive area in reach gets (0, 0, 1).
    """
    corner = vertices[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    twice_area = np.linalg.norm(cross, axis=1)
    group = _smooth_groups(faces, _unit(cross), crease_rad)
    weight = twice_area[:, None] * _corner_angles(corner)
    weighted = (weight[..., None] * _unit(cross)[:, None, :]).reshape(-1, 3)
    total = np.stack([np.bincount(group, weighted[:, i]) for i in range(3)], axis=1)
    return _unit(total)[group].reshape(len(faces), 3, 3)


def _smooth_groups(
    faces: Int[np.ndarray, "f 3"], face_normal: Float[np.ndarray, "f 3"], crease_rad: float
) -> Int[np.ndarray, " c"]:
    """Return a label per corner (face major); corners with equal labels share one normal."""
    n = len(faces)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()  # Edge i starts at corner i.
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    same_as_next = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    rise = np.diff(
        np.concatenate([[0], same_as_next, [0]])
    )  # +1 begins a run of equal values, -1 ends it.
    first, last = np.flatnonzero(rise > 0), np.flatnonzero(rise < 0)
    pair = first[last - first == 1]
    a, b = order[pair], order[pair + 1]
    # atan2 of |cross| and dot keeps its accuracy at small angles, where arccos loses it.
    n_a, n_b = face_normal[a // 3], face_normal[b // 3]
    turn = np.arctan2(np.linalg.norm(np.cross(n_a, n_b), axis=1), np.einsum("ij,ij->i", n_a, n_b))
    # Faces with the same winding traverse their edge in opposite directions; only these are joined.
    joined = (turn <= crease_rad) & (start[a] == end[b])
    a, b = a[joined], b[joined]
    following = np.roll(np.arange(3 * n).reshape(n, 3), -1, axis=1).ravel()
    # One half of the edge starts where the other ends.
    link_a, link_b = np.concatenate([a, following[a]]), np.concatenate([following[b], b])
    links = coo_array((np.ones(len(link_a), dtype=bool), (link_a, link_b)), shape=(3 * n, 3 * n))
    return connected_components(links, directed=False)[1]


def _corner_angles(corner: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    forward = _unit(np.roll(corner, -1, axis=1) - corner)
    backward = _unit(np.roll(corner, 1, axis=1) - corner)
    sine = np.linalg.norm(np.cross(forward, backward), axis=-1)
    return np.arctan2(sine, np.einsum("fci,fci->fc", forward, backward))


def _unit(vector: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Scale vectors to length 1; a null vector becomes (0, 0, 1)."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    unit = vector / np.where(length > 0, length, 1.0)
    return np.where(length > 0, unit, np.array([0.0, 0.0, 1.0]))
