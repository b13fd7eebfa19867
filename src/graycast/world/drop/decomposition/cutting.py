"""Cut a solid into pieces that are convex within a tolerance.

First the solid is cut along its own flat faces, so that a bolt's head comes off whole and the hulls
have the mesh's vertices. Then round pieces are cut into wedges. The rest is cut by the best of many
planes, until every piece's hull follows the body.

Leaves out: looking more than one cut ahead, as the search of CoACD does (Wei et al., "Approximate
Convex Decomposition for 3D Meshes with Collision-Aware Concavity and Tree Search", SIGGRAPH 2022).
On the test parts, it makes no more hulls than CoACD, reproduces parts made of convex pieces
exactly, and has a bounded error, unlike CoACD.
"""

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from ...parts.surface import surface_of
from .error import LID_SAMPLES, filled_m, spread, surface_samples
from .solid import Points

REFLEX_RAD = np.radians(12)  # A smaller inward bend belongs to a facet of a round shape.
PLANES = 12  # At most this many flat faces are tried, those at the longest bends first.
WORTH = 0.2  # A cut must remove at least this share of the volume that the hull adds.
WEDGES = (3, 4, 6, 8, 12, 16, 24)  # These numbers divide the usual facet counts of round shapes.
ACROSS = (0.2, 0.35, 0.5, 0.65, 0.8)  # Cuts are tried at these shares of a piece's extent.
ROUND = 0.02  # A piece is round if two principal variances differ by less than this share.
# Costs of one more part, of the largest part's share and of the cut's share of the surface,
# relative to the volume to fill. Without these costs, thin slices are cut off one after another.
EACH, EVEN, CUT = 0.01, 0.02, 0.2
GUESSES, FIRST_GUESSES = (
    120,
    24,
)  # Points tested per hull: all, and the first few, which reject a bad hull early.
DEEPEST_CUTS = 40  # After this many consecutive cuts, a piece is accepted unchanged.
THIN = 0.02  # Sheets and slivers thinner than this share of the limit (9 um) are ignored.
HAIR = 0.01  # A cut is offset from its plane by this share of the thinnest sheet's thickness.

Plane = tuple[Float[np.ndarray, "3"], float]
"""Unit normal n and offset d [m] of the plane n . p = d."""


class Cutter:
    """A cutter for one body; `limit_m` is how far a piece's hull may reach out of the body."""

    def __init__(self, body: Manifold, limit_m: float) -> None:
        self._body, self.limit_m, self._thin_m = body, limit_m, THIN * limit_m
        self.worked = 0  # number of faces of all pieces cut so far, which determines the time
        self._surface = surface_samples(body)

    def guessed_harm_m(self, points: Points) -> float:
        """Estimate quickly how far the hull of some points reaches out of the body [m].

        The value may be too small, so `fits` decides. A test of a few samples rejects most
        hulls that reach too far.
        """
        sample = spread(Manifold.hull_points(points), GUESSES)[0]
        few = sample[:FIRST_GUESSES]
        harm_m = self._surface.outside_m(few)
        return harm_m if harm_m > self.limit_m else max(harm_m, self._surface.outside_m(sample))

    def fits(self, hull: Manifold) -> bool:
        """Return whether a hull stays within the limit outside the body."""
        return filled_m(hull, self._body, self._surface) <= self.limit_m

    def pieces(self) -> Iterator[Manifold]:
        """Yield pieces of the body whose hulls fit, one after another."""
        waiting = [(self._body, 0)]
        while waiting:
            piece, cuts = waiting.pop()
            parts: list[Manifold] = []
            if cuts < DEEPEST_CUTS and not self.fits(piece.hull()):
                self.worked += piece.num_tri()
                parts = (
                    _cut_along_a_face(piece, self._thin_m)
                    or self._wedges(piece)
                    or _cut_anywhere(piece, self._deepest(piece), self._thin_m)
                )
            if parts:
                waiting += [(part, cuts + 1) for part in parts]
            else:
                yield piece

    def _deepest(self, piece: Manifold) -> Float[np.ndarray, "3"]:
        """Return the point of the piece's hull that is about the farthest from the body."""
        point = spread(piece.hull() - self._body, LID_SAMPLES)[0]
        return point[self._surface.tree.query(point)[0].argmax()]

    def _wedges(self, piece: Manifold) -> list[Manifold]:
        """Cut a round piece into the fewest wedges that fit; return [] for other pieces."""
        center, axes, moments = _principal(piece)  # The moments are in ascending order.
        lower, upper = moments[1] - moments[0], moments[2] - moments[1]
        if min(lower, upper) > ROUND * moments[2]:
            return []
        axis = axes[:, 2] if lower < upper else axes[:, 0]  # the axis of a tube or of a washer
        for count in WEDGES:
            wedges = []
            for wedge in _fan(piece, axis, center, count, self._thin_m):
                wedges.append(wedge)
                if not self.fits(wedge.hull()):
                    break
            else:
                return wedges
        return []


def _filling(piece: Manifold) -> float:
    """Return the volume of the hull minus the volume of the piece [m^3]."""
    return piece.hull().volume() - piece.volume()


def _split(piece: Manifold, plane: Plane, thin_m: float) -> list[Manifold]:
    """Return the parts on both sides of a plane.

    A face in the plane would remain on the other part as a sheet without thickness, and widen that
    part's hull. So each side is cut slightly off the plane.
    """
    normal, offset = plane
    hair_m = HAIR * thin_m
    beyond = piece.trim_by_plane(tuple(normal), float(offset) + hair_m)
    before = piece.trim_by_plane(tuple(-normal), hair_m - float(offset))
    return _parts(beyond, thin_m) + _parts(before, thin_m)


def _parts(piece: Manifold, thin_m: float) -> list[Manifold]:
    """Return the parts of a cut, without those whose mean thickness is below the limit."""
    return [part for part in piece.decompose() if 2 * part.volume() > thin_m * part.surface_area()]


def _cut_along_a_face(piece: Manifold, thin_m: float) -> list[Manifold]:
    """Cut along the flat face that leaves the least to fill; return [] if the gain is small."""
    filling = _filling(piece)
    parts, left = _best_cut(piece, _faces_at_bends(piece), filling, even=0.0, thin_m=thin_m)
    return parts if left < (1 - WORTH) * filling else []


def _cut_anywhere(
    piece: Manifold, deepest: Float[np.ndarray, "3"], thin_m: float
) -> list[Manifold]:
    """Cut by the best of many planes, even for a small gain; return [] if no plane cuts."""
    planes = chain(_planes_across(piece, deepest), _faces_at_bends(piece))
    parts, _ = _best_cut(piece, planes, _filling(piece), even=EVEN, thin_m=thin_m)
    return parts


def _best_cut(
    piece: Manifold, planes: Iterable[Plane], filling: float, *, even: float, thin_m: float
) -> tuple[list[Manifold], float]:
    """Return the parts of the best cut, and the volume that their hulls add to them.

    Among planes that leave about the same volume, a plane with few parts of similar size and a
    small cut is preferred. So a plate is not split into two thinner plates with the same holes.
    """
    best, least, left = [], np.inf, np.inf
    for plane in planes:
        parts = _split(piece, plane, thin_m)
        if len(parts) < 2:
            continue
        volume = [part.volume() for part in parts]
        filled = sum(map(_filling, parts))
        cut = sum(part.surface_area() for part in parts) / piece.surface_area() - 1
        ugly = EACH * len(parts) + even * max(volume) / sum(volume) + CUT * cut
        if filled + ugly * filling < least:
            best, least, left = parts, filled + ugly * filling, filled
    return best, left


def _planes_across(piece: Manifold, deepest: Float[np.ndarray, "3"]) -> Iterator[Plane]:
    """Yield planes across the principal axes, first through the centroid and the deepest point."""
    vertices, _ = surface_of(piece)
    center, axes, _ = _principal(piece)
    for axis in axes.T:
        height = vertices @ axis
        yield axis, float(axis @ center)
        yield axis, float(axis @ deepest)
        for share in ACROSS:
            yield axis, float(height.min() + share * np.ptp(height))


def _faces_at_bends(piece: Manifold) -> Iterator[Plane]:
    """Yield planes of faces next to concave edges; those with the longest edges first."""
    vertices, faces = surface_of(piece)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    here = np.repeat(np.arange(len(faces)), 3)
    edge, back = start * len(vertices) + end, end * len(vertices) + start
    order = np.argsort(edge)
    twin = order[np.searchsorted(edge[order], back)]  # Each edge of a manifold occurs twice.
    there = here[twin]
    apex = vertices[np.roll(faces, -2, axis=1).ravel()][twin]
    above = np.einsum("ei,ei->e", apex - vertices[start], normal[here])
    sine = np.linalg.norm(np.cross(normal[here], normal[there]), axis=1)
    bend = np.arctan2(sine, np.einsum("ei,ei->e", normal[here], normal[there]))
    length = np.linalg.norm(vertices[end] - vertices[start], axis=1)
    size = float(np.ptp(vertices, axis=0).max())
    inward = (above > 1e-6 * size) & (bend > REFLEX_RAD)
    if not inward.any():
        return
    plane = np.column_stack(
        [normal[here], np.einsum("ei,ei->e", normal[here], vertices[start]) / size]
    )[inward]
    largest = np.abs(plane[:, :3]).argmax(axis=1)
    rounded = (plane * np.sign(plane[np.arange(len(plane)), largest])[:, None]).round(4)
    _, first, group = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    weight = np.bincount(group.ravel(), (length * bend)[inward])
    for i in first[np.argsort(-weight, kind="stable")[:PLANES]]:
        yield plane[i, :3], float(plane[i, 3] * size)


def _principal(
    piece: Manifold,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return the centre of mass, principal axes (columns) and their variances, ascending."""
    vertices, faces = surface_of(piece)
    corner = vertices[faces]
    volume = np.linalg.det(corner)
    total = corner.sum(axis=1)
    center = np.einsum("f,fi->i", volume, total) / 4 / volume.sum()
    second = np.einsum("f,fi,fj->ij", volume, total, total)
    second = (second + np.einsum("f,fki,fkj->ij", volume, corner, corner)) / 20
    second = second / volume.sum() - np.outer(center, center)
    variance, axes = np.linalg.eigh(second)
    return center, axes, variance


def _fan(
    piece: Manifold,
    axis: Float[np.ndarray, "3"],
    point: Float[np.ndarray, "3"],
    count: int,
    thin_m: float,
) -> Iterator[Manifold]:
    """Yield wedges of equal angle about an axis; the first cut goes through the farthest vertex."""
    vertices, _ = surface_of(piece)
    across = vertices - point
    across = across - np.outer(across @ axis, axis)
    far = across[np.linalg.norm(across, axis=1).round(9).argmax()]
    u = far / np.linalg.norm(far)
    v = np.cross(axis, u)
    angle = 2 * np.pi * np.arange(count) / count
    side = np.outer(-np.sin(angle), u) + np.outer(
        np.cos(angle), v
    )  # Angles increase in this direction.
    for after, before in zip(side, -np.roll(side, -1, axis=0), strict=True):
        wedge = piece.trim_by_plane(tuple(after), float(after @ point))
        wedge = wedge.trim_by_plane(tuple(before), float(before @ point))
        yield from _parts(wedge, thin_m)
