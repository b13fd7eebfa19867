"""Protocol for the shape of a bin in fits: the flat faces of a box or a mesh."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from .bin_views import Grid

NO_FACE = -1
COS_ALIKE = 0.707  # The normals of a point and its face differ by at most 45 degrees.


@runtime_checkable
class BinShape(Protocol):
    """Faces in planes `normal . p = offset_m`, grouped into surfaces such as the floor.

    World frame: origin in the middle of the inner floor, z up. The normal points to the visible
    side of a face.
    """

    @property
    def inner_m(self) -> tuple[float, float, float]: ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the surfaces, such as "floor" and "wall +x"."""
        ...

    @property
    def surface(self) -> Int[np.ndarray, " f"]:
        """Index of the surface of each face."""
        ...

    @property
    def normal(self) -> Float[np.ndarray, "f 3"]: ...

    @property
    def offset_m(self) -> Float[np.ndarray, " f"]: ...

    @property
    def axis(self) -> Int[np.ndarray, " f"]:
        """Index of the world axis that is nearest to each face's normal."""
        ...

    @property
    def bounds_m(self) -> Float[np.ndarray, "2 3"]: ...

    def nearest(
        self,
        point: Float[np.ndarray, "n 3"],
        normal: Float[np.ndarray, "n 3"],
        eye_m: Float[np.ndarray, "3"],
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the nearest face to each point, and its distance [m].

        Only faces count that face `eye_m` and whose normal is within 45 degrees of the point's
        normal. Without such a face, the result is `NO_FACE` and infinity.
        """
        ...

    def cast(
        self, T_world_cam: Float[np.ndarray, "4 4"], grid: Grid
    ) -> tuple[Int[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
        """Return the first face that each pixel's ray hits, from either side, and its z-depth [m].

        If a ray hits no face, the result is `NO_FACE` and infinity.
        """
        ...

    def votes(
        self, T_world_cam: Float[np.ndarray, "p 4 4"], grid: Grid, tolerance_m: float
    ) -> Float[np.ndarray, " p"]:
        """Return the votes for each pose, summed over the measured pixels.

        A pixel counts 1 if its depth agrees, falling to 0 at a difference of `tolerance_m`. It
        counts -1 if its depth is behind a face, which would have hidden the point, and else 0.
        """
        ...


def height_over(
    shape: BinShape, point: Float[np.ndarray, "*n 3"], face: Int[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Return the distance [m] of points from their face's plane, positive on the visible side."""
    return (shape.normal[face] * point).sum(axis=-1) - shape.offset_m[face]


def is_floor(shape: BinShape) -> Bool[np.ndarray, " f"]:
    """Return a mask of the faces of the inner floor."""
    return np.array(shape.names)[shape.surface] == "floor"
