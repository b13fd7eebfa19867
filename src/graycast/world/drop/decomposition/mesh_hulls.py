"""Make the convex hulls of a mesh: cut it into pieces, and join pieces that fit one hull."""

import heapq

import numpy as np
from jaxtyping import Int
from manifold3d import Manifold

from ....base.progress import UNWATCHED, ProgressMeter
from ...parts import Mesh
from ...parts.surface import surface_of
from .cutting import Cutter
from .error import tolerance_m
from .solid import Hull, Points, bodies_of, hull_of, simplified, thinned

# Largest shrinkage of a hull that loses vertices, as a share of the box diagonal. A scanned box
# with 129 vertices (0.03 %) on nearly flat sides rocked forever; with 51 (0.3 %) it comes to rest.
VERTEX_TOLERANCE_OF_DIAGONAL = 0.003
# Cutting and joining may use this share of the tolerance, minus the shift by simplifying. The rest
# is a margin for errors between the sample points at which the distance is measured.
CUT_SHARE = 0.9
# With more pieces a drop is too slow, and with more cuts (counted by the faces that are cut) the
# user waits too long. At these limits the tolerance grows by this factor. A turned ring has the
# most cut faces of the test parts, 43,000.
MOST_PIECES, MOST_FACES_CUT, COARSER = 200, 120_000, 2.0
_CONVEX = 1e-9  # Round-off alone may make a body smaller than its hull by this share.
_PROGRESS_EACH = 25  # Progress is reported after each group of this many pieces.


def decompose(mesh: Mesh, *, progress: ProgressMeter = UNWATCHED) -> tuple[Hull, ...]:
    """Make the hulls of a mesh in this process, without measuring their errors.

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
    """Return hulls of the pieces; return [] if there are too many or cutting takes too long."""
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
    """Return whether a mesh is convex within the tolerance."""
    bodies = bodies_of(mesh)
    limit_m = CUT_SHARE * tolerance_m(mesh)
    return len(bodies) == 1 and Cutter(bodies[0], limit_m).fits(bodies[0].hull())


def _hulls_of(whole: Manifold, tolerance: float, of: str, progress: ProgressMeter) -> list[Points]:
    hull = whole.hull()
    if hull.volume() - whole.volume() < _CONVEX * hull.volume():
        return [surface_of(hull)[0]]
    while True:
        body, moved_m = simplified(whole, tolerance)
        cutter = Cutter(body, CUT_SHARE * tolerance - moved_m)
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
    return _joined(points, cutter)


def _joined(hulls: list[Points], cutter: Cutter) -> list[Points]:
    """Join pairs of hulls within the tolerance; the pair that adds the smallest error comes first.

    The time of a drop grows with the number of hulls, and cuts leave more hulls than needed.
    """
    alive = dict(enumerate(hulls))
    waiting: list[tuple[float, int, int]] = []

    def consider(i: int, j: int) -> None:
        harm = cutter.guessed_harm_m(np.vstack([alive[i], alive[j]]))
        if harm <= cutter.limit_m:
            heapq.heappush(waiting, (harm, i, j))

    for j in range(1, len(hulls)):
        for i in _near(hulls[:j], hulls[j], cutter.limit_m):
            consider(int(i), j)
    new = len(hulls)
    while waiting:
        _, i, j = heapq.heappop(waiting)
        if i not in alive or j not in alive:
            continue
        hull = Manifold.hull_points(np.vstack([alive[i], alive[j]]))
        if not cutter.fits(hull):
            continue
        del alive[i], alive[j]
        both = surface_of(hull)[0]
        names = list(alive)
        near = _near(list(alive.values()), both, cutter.limit_m)
        alive[new] = both
        for other in near:
            consider(names[other], new)
        new += 1
    return list(alive.values())


def _near(others: list[Points], one: Points, gap_m: float) -> Int[np.ndarray, " n"]:
    """Return the indices of hulls whose bounding boxes are within a gap of one hull's box."""
    if not others:
        return np.empty(0, dtype=np.int64)
    low = np.array([points.min(axis=0) for points in others])
    high = np.array([points.max(axis=0) for points in others])
    near = (low <= one.max(axis=0) + gap_m) & (one.min(axis=0) <= high + gap_m)
    return np.flatnonzero(near.all(axis=1))
