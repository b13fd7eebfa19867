"""From a mesh to its hulls."""

import numpy as np
from manifold3d import Manifold

from ....base.progress import UNWATCHED, ProgressMeter
from ...parts import Mesh
from .cutting import Cutter, Points
from .error import tolerance_m
from .hulls import Hull, hull_of, thinned
from .joining import joined
from .solid import bodies_of, simplified, surface_of

# A hull that loses vertices may shrink so far, of the box diagonal. A scanned box whose nearly flat
# sides kept 129 vertices (0.03 %) rocked on them for ever; with 51 (0.3 %) it comes to rest.
VERTEX_TOLERANCE_OF_DIAGONAL = 0.003
# Cutting and joining may fill this share, less what simplifying moved; the rest of the tolerance is
# for what lies between the samples that look for the worst place.
CUT_SHARE = 0.9
# No drop has time for more pieces, and no user for more cuts, counted by the faces of what is cut
# (most in the zoo: 43,000, of a turned ring). Then the tolerance grows by this.
MOST_PIECES, MOST_FACES_CUT, COARSER = 200, 120_000, 2.0
_CONVEX = 1e-9  # A body may lack this share of its hull's volume by round-off alone.
_PROGRESS_EACH = 25  # Progress is shown anew after so many pieces.


def decompose(mesh: Mesh, *, progress: ProgressMeter = UNWATCHED) -> tuple[Hull, ...]:
    """The hulls of `convex_hulls`, not measured, made in this process.

    Raises:
        ValueError: the mesh is not closed, or inside out.
    """
    progress.stage(f"building a solid from {len(mesh.faces)} faces")
    tolerance = tolerance_m(mesh)
    thin_m = VERTEX_TOLERANCE_OF_DIAGONAL * float(np.linalg.norm(mesh.extent_m))
    hulls: list[Points] = []
    bodies = bodies_of(mesh)
    for number, body in enumerate(bodies, 1):
        of = f", body {number} of {len(bodies)}" if len(bodies) > 1 else ""
        hulls += _hulls_of(body, tolerance, of, progress)
    progress.stage(f"simplifying {len(hulls)} hulls")
    corners = [hull_of(points)[0] for points in hulls]
    return tuple(hull_of(thinned(vertices, thin_m)) for vertices in corners)


def _pieces(cutter: Cutter, body: Manifold, of: str, progress: ProgressMeter) -> list[Manifold]:
    """Hulls of the pieces; none if there are too many, or it takes too long."""
    pieces: list[Manifold] = []
    for piece in cutter.pieces():
        if len(pieces) == MOST_PIECES or cutter.worked > MOST_FACES_CUT:
            return []
        if len(pieces) % _PROGRESS_EACH == 0:
            done = f"{len(pieces)} so far{of}"
            progress.stage(f"cutting {body.num_tri()} faces into convex pieces, {done}")
        pieces.append(piece.hull())
    return pieces


def is_one_hull(mesh: Mesh) -> bool:
    """Whether a mesh is convex within the tolerance."""
    bodies = bodies_of(mesh)
    limit_m = CUT_SHARE * tolerance_m(mesh)
    return len(bodies) == 1 and Cutter(bodies[0], limit_m).fits(bodies[0])


def _hulls_of(whole: Manifold, tolerance: float, of: str, progress: ProgressMeter) -> list[Points]:
    hull = whole.hull()
    if hull.volume() - whole.volume() < _CONVEX * hull.volume():
        return [surface_of(hull)[0]]
    while True:
        body, moved_m = simplified(whole, tolerance)
        limit_m = CUT_SHARE * tolerance - moved_m
        cutter = Cutter(body, limit_m)
        pieces = _pieces(cutter, body, of, progress)
        if pieces:
            break
        tolerance *= COARSER
        progress.stage(
            f"the mesh is too detailed for this bound: cutting within {1e3 * tolerance:.2f} mm{of}"
        )
    points = [surface_of(piece)[0] for piece in pieces]
    if len(points) == 1:
        return points
    progress.stage(f"joining {len(points)} hulls{of}")
    return joined(points, limit_m, guess_m=cutter.guessed_harm_m, holds=cutter.hold)
