"""A part's mesh as solids: its bodies, without their cavities, with no more faces than needed."""

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold, OpType

from ...parts import Mesh
from ...parts.shells import ShellError, separate, shells_of

# These shares of the tolerance are tried in turn until so few faces are left: each costs time.
SIMPLIFIED_BY = (0.1, 0.2, 0.3)
ENOUGH_FACES = 12_500


def bodies_of(mesh: Mesh) -> tuple[Manifold, ...]:
    """The separate bodies that a closed mesh consists of, largest first, cavities filled.

    Bodies that overlap or touch along a face become one; what lies inside another is none.

    Raises:
        ValueError: the mesh is not closed.
    """
    try:
        shells, _ = shells_of(mesh.vertices_m, mesh.faces)
    except ShellError as error:
        raise ValueError(str(error)) from error
    if not shells:
        raise ValueError("the mesh encloses no volume: turn its faces outward")
    joined = Manifold.batch_boolean(shells, OpType.Add) if len(shells) > 1 else shells[0]
    bodies = [body for body in separate(joined) if body.volume() > 0]
    return tuple(sorted(bodies, key=lambda body: -body.volume()))


def simplified(body: Manifold, tolerance_m: float) -> tuple[Manifold, float]:
    """The body with fewer faces, a subset of its vertices; how far its surface may have moved [m].

    That is 0.1 of the tolerance, up to 0.3 where more than `ENOUGH_FACES` would be left.
    """
    fewer, moved_m = body, 0.0
    for share in SIMPLIFIED_BY:
        if fewer.num_tri() <= ENOUGH_FACES:
            break
        moved_m = share * tolerance_m
        fewer = body.simplify(moved_m)
    return fewer, moved_m


def surface_of(
    solid: Manifold,
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices and faces."""
    mesh = solid.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], dtype=np.float64)
    return vertices, np.asarray(mesh.tri_verts).astype(np.int64)
