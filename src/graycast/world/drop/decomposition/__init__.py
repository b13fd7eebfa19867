"""Convex decomposition: a part's mesh as a few convex hulls for the physics engine.

The hulls follow the part's outer surface within a tolerance (`tolerance_m`): no point of a hull is
farther outside the part, so holes stay open, and no point of the surface is farther outside the
union of the hulls. Cavities, which cannot be reached from outside, are filled.

`solid` reads the mesh, `error` measures the hulls, `cutting` cuts the mesh, `mesh_hulls` makes
hulls of the pieces and joins hulls where possible, `hull_process` does all of this in child
processes that can be ended, and `hull_store` stores the results.
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
