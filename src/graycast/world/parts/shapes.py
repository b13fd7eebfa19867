"""Solids for the built-in parts: bodies of revolution, lofts, and boxes with rounded edges.

Every shape is a closed surface, counter-clockwise seen from outside, in the unit of the input.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold

from .surface import manifold_of

# Each panel of a box has its outward normal, and the directions right and up of its print, seen
# from outside; the front faces -y. right x up = normal, so nothing is mirrored.
PANELS: dict[str, tuple[tuple[int, int, int], tuple[int, int, int], tuple[int, int, int]]] = {
    "front": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "right": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "back": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "left": ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
    "top": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "bottom": ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
}

Surface = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


def revolve(profile: Float[np.ndarray, "p 2"], segments: int) -> Surface:
    """Turn a closed profile (r, z), counter-clockwise and with r > 0, once around the z axis."""
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    xy = profile[:, None, :1] * ring
    z = np.broadcast_to(profile[:, None, 1:], (*xy.shape[:2], 1))
    vertices = np.concatenate([xy, z], axis=-1).reshape(-1, 3)
    return vertices, _band(len(profile), segments, closed=True)


def loft(sections: Float[np.ndarray, "s n 3"]) -> Surface:
    """Return a skin over sections, bottom to top, counter-clockwise from above, with flat ends."""
    s, n = sections.shape[:2]
    ends = sections[[0, -1]].mean(axis=1)
    vertices = np.concatenate([sections.reshape(-1, 3), ends])
    i = np.arange(n)
    j = (i + 1) % n
    bottom = np.stack([np.full(n, s * n), j, i], axis=1)
    top = np.stack([np.full(n, s * n + 1), (s - 1) * n + i, (s - 1) * n + j], axis=1)
    return vertices, np.concatenate([_band(s, n, closed=False), bottom, top])


def _band(rows: int, columns: int, *, closed: bool) -> Int[np.ndarray, "f 3"]:
    """Return two triangles per cell of a grid of vertices that is closed along its columns."""
    grid = np.meshgrid(np.arange(rows if closed else rows - 1), np.arange(columns), indexing="ij")
    i, a = (place.ravel() for place in grid)
    j, b = (i + 1) % rows, (a + 1) % columns
    corners = [i * columns + a, i * columns + b, j * columns + b, j * columns + a]
    lower = np.stack(corners[:3], axis=1)
    upper = np.stack([corners[0], corners[2], corners[3]], axis=1)
    return np.concatenate([lower, upper])


def superellipse(
    half_x: float, half_y: float, exponent: float, z: float, points: int
) -> Float[np.ndarray, "n 3"]:
    """Return points of |x/a|^n + |y/b|^n = 1 at height z, at even angles: +y first, then -x."""
    angle = np.pi / 2 + 2 * np.pi * np.arange(points) / points
    cosine, sine = np.cos(angle), np.sin(angle)
    scale = (np.abs(cosine) ** exponent + np.abs(sine) ** exponent) ** (-1 / exponent)
    return np.stack([half_x * scale * cosine, half_y * scale * sine, np.full(points, z)], axis=1)


def rounded_box(
    size: tuple[float, float, float], radius: float, steps: int
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"], tuple[str, ...]]:
    """Return a centred box with rounded edges; half of each edge belongs to each panel.

    Args:
        size: outer lengths along x, y and z.
        radius: radius of the rounded edges.
        steps: number of facets from the flat face to the middle of an edge.

    Returns:
        vertices, faces, and the panel (of `PANELS`) that each face belongs to.
    """
    # A grid on the unit cube: `steps` rounded cells, one flat cell, `steps` rounded cells.
    tangent = np.tan(np.pi / 4 * np.arange(steps + 1) / steps)
    offset = np.concatenate(
        [-tangent[::-1], tangent]
    )  # from the middle of an edge to the flat face
    side = np.concatenate([-np.ones(steps + 1), np.ones(steps + 1)])
    count = len(offset)
    index: list[Int[np.ndarray, "n 3"]] = []
    faces: list[Int[np.ndarray, "f 3"]] = []
    panel_of_face: list[str] = []
    for panel, (_, right, up) in PANELS.items():
        i, j = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
        index.append(_cube_grid(i.ravel(), j.ravel(), np.array(right), np.array(up), count))
        corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
        corner = corner + count * count * len(faces)
        quad = [corner, corner + count, corner + count + 1, corner + 1]
        faces.append(np.concatenate([np.stack(quad[:3], 1), np.stack([quad[0], *quad[2:]], 1)]))
        panel_of_face += [panel] * len(faces[-1])
    grid, where = np.unique(np.concatenate(index), axis=0, return_inverse=True)
    direction = offset[grid]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    core = np.array(size) / 2 - radius
    vertices = side[grid] * core + radius * direction
    return vertices, where.reshape(-1)[np.concatenate(faces)], tuple(panel_of_face)


def _cube_grid(
    i: Int[np.ndarray, " n"],
    j: Int[np.ndarray, " n"],
    right: Int[np.ndarray, "3"],
    up: Int[np.ndarray, "3"],
    count: int,
) -> Int[np.ndarray, "n 3"]:
    """Return the cube's grid coordinates for steps i to the right and j up on one panel."""
    normal = np.cross(right, up)
    # Double the coordinates and subtract the end, so that each axis is symmetric about 0.
    end = count - 1
    doubled = np.outer(2 * i - end, right) + np.outer(2 * j - end, up) + end * normal
    return (doubled + end) // 2


def solid(surface: Surface) -> Manifold:
    """Return a closed surface as a solid for boolean operations."""
    manifold = manifold_of(*surface)
    if manifold.is_empty():
        raise ValueError(f"not a closed surface: {manifold.status()}")
    return manifold


def union(
    pieces: Mapping[str, Manifold],
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"], tuple[str, ...]]:
    """Return the union of named solids, and the name of the piece that each face came from."""
    whole = Manifold()
    name_of_id = {}
    for name, piece in pieces.items():
        original = piece.as_original()
        name_of_id[original.original_id()] = name
        whole = whole + original
    mesh = whole.to_mesh64()
    faces = np.asarray(mesh.tri_verts).astype(np.int64)
    run = np.asarray(mesh.run_index) // 3
    names = np.repeat([name_of_id[k] for k in mesh.run_original_id], np.diff(run))
    return np.array(mesh.vert_properties[:, :3]), faces, tuple(names.tolist())
