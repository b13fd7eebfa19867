"""Convex decomposition: a part's mesh as a few convex hulls for the physics engine.

The hulls follow the part's outer surface within a tolerance (`tolerance_m`): no point of them lies
farther outside the part, so a hole stays open, and no point of the surface farther outside all of
them. What cannot be reached from outside, a cavity, is filled.

`solid` reads the mesh, `error` measures, `cutting` takes it apart, `mesh_hulls` makes hulls of the
pieces and joins those that may be one; `hull_process` does all that in processes that can be ended,
and `hull_store` keeps the results.
"""

from .error import Decomposition, measure, tolerance_m
from .hull_store import prepare
from .mesh_hulls import decompose
from .solid import Hull, hull_of

__all__ = [
    "Decomposition",
    "Hull",
    "decompose",
    "hull_of",
    "measure",
    "prepare",
    "tolerance_m",
]
