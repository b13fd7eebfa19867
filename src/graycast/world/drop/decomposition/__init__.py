"""Convex decomposition: a part's mesh as a few convex hulls for the physics engine.

The hulls follow the part's outer surface within a tolerance (`tolerance_m`): no point of them lies
farther outside the part, so a hole stays open, and no point of the surface farther outside all of
them. What cannot be reached from outside, a cavity, is filled.

`solid` reads the mesh, `cutting` takes it apart, `joining` makes hulls of the pieces and joins
those that may be one, `error` measures; `child` does all that in processes that can be ended, and
`ready` keeps the results.
"""

from .cache import cache_folder
from .error import Decomposition, HullError, hull_error, tolerance_m
from .hull_store import convex_hulls, convex_hulls_of
from .hulls import Hull, hull_of
from .mesh_hulls import decompose

__all__ = [
    "Decomposition",
    "Hull",
    "HullError",
    "cache_folder",
    "convex_hulls",
    "convex_hulls_of",
    "decompose",
    "hull_error",
    "hull_of",
    "tolerance_m",
]
