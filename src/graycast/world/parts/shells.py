"""Conversion of the closed shells of a mesh file to one solid."""

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Error, Manifold, Mesh64, OpType
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

TOUCHING = 1e-4  # Bodies that merely touch share so much of the whole volume: the file rounds.


class ShellError(Exception):
    """The shells do not form a solid; the text states why, and the remedy."""


def manifold_of(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Manifold:
    return Manifold(Mesh64(vert_properties=vertices, tri_verts=faces.astype(np.uint64)))


def surface_of(solid: Manifold) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices and faces."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.asarray(mesh.tri_verts).astype(np.int64)


def shells_of(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[tuple[Manifold, ...], tuple[Manifold, ...]]:
    """A closed mesh's shells that face outwards, and those that face inwards.

    Bodies that share no more than a vertex or an edge are shells of their own.

    Raises:
        ShellError: the surface is not closed, or crosses itself in a way that has no inside.
    """
    whole = manifold_of(vertices.copy(), faces)
    if whole.status() != Error.NoError:
        raise ShellError(
            f"the surface does not enclose a solid ({whole.status().name}); close its holes and "
            "turn its faces outward"
        )
    shells = separate(whole)
    outward = tuple(shell for shell in shells if shell.volume() >= 0)
    return outward, tuple(shell for shell in shells if shell.volume() < 0)


def separate(whole: Manifold) -> tuple[Manifold, ...]:
    """The shells of a solid. (The library's own way takes the square of their number.)"""
    vertices, faces = surface_of(whole)
    links = (np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()))
    count, label = connected_components(
        coo_array(links, shape=(len(vertices),) * 2), directed=False
    )
    if count == 1:
        return (whole,)
    by_shell, of_shell = np.argsort(label, kind="stable"), np.bincount(label, minlength=count)
    place = np.empty(len(label), dtype=np.int64)  # of each vertex within its shell
    place[by_shell] = np.arange(len(label)) - np.repeat(of_shell.cumsum() - of_shell, of_shell)
    order = np.argsort(label[faces[:, 0]], kind="stable")
    ends = np.bincount(label[faces[:, 0]], minlength=count).cumsum()[:-1]
    return tuple(
        manifold_of(vertices[rows], place[some])
        for rows, some in zip(
            np.split(by_shell, of_shell.cumsum()[:-1]), np.split(faces[order], ends), strict=True
        )
    )


def union_if_overlapping(
    outward: tuple[Manifold, ...], inward: tuple[Manifold, ...]
) -> tuple[Manifold, float] | None:
    """The union of bodies where they overlap, and the share of volume that would count twice.

    A shell that faces inwards is a cavity of the smallest body whose box holds its own.

    Returns:
        None where no two bodies share more than `TOUCHING` of the whole: the mesh is right as
        it is.

    Raises:
        ShellError: a shell that faces inwards lies in no other.
    """
    order = sorted(range(len(outward)), key=lambda i: outward[i].volume())
    cavities: list[list[Manifold]] = [[] for _ in outward]
    boxes = np.array([body.bounding_box() for body in outward])
    for shell in inward:
        box = np.array(shell.bounding_box())
        holds = np.all((boxes[:, :3] <= box[:3]) & (boxes[:, 3:] >= box[3:]), axis=1)
        around = [i for i in order if holds[i] and outward[i].volume() > -shell.volume()]
        if not around:
            raise ShellError(
                "a part of the surface is inside out: a shell that faces inwards is not inside "
                "another shell; flip its normals"
            )
        cavities[around[0]].append(shell)
    if len(outward) == 1:
        return None
    bodies = [
        _hollow(body, holes) if holes else body
        for body, holes in zip(outward, cavities, strict=True)
    ]
    union = Manifold.batch_boolean(bodies, OpType.Add)
    total = sum(body.volume() for body in bodies)
    twice = (total - union.volume()) / total
    return (union, twice) if twice > TOUCHING else None


def _hollow(body: Manifold, holes: list[Manifold]) -> Manifold:
    """A body and its cavities, whose faces look into them, as one solid."""
    vertices, faces = zip(*map(surface_of, (body, *holes)), strict=True)
    starts = np.cumsum([0] + [len(corners) for corners in vertices])[:-1]
    moved = [own + start for own, start in zip(faces, starts, strict=True)]
    return manifold_of(np.vstack(vertices), np.vstack(moved))
