"""Protocol of a bin for fits: flat faces in the world frame, of a box or of a mesh."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from .bin_views import Grid

NO_FACE = -1
COS_ALIKE = 0.707  # The normals of a point and of its face differ by at most 45 degrees.


@runtime_checkable
class BinShape(Protocol):
    """Faces in planes `normal . p = offset_m`; several faces may make one surface.

    World frame: origin in the middle of the inner floor, z up. Normals point to the visible side of
    a face.
    """

    @property
    def inner_m(self) -> tuple[float, float, float]: ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the surfaces, such as floor and wall +x."""
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
        """Index of the world's axis to which each face is perpendicular, or nearly."""
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

        Only faces count that are visible from `eye_m` and within 45 degrees of the point's normal;
        without such a face, the result is `NO_FACE` and inf.
        """
        ...

    def cast(
        self, T_world_cam: Float[np.ndarray, "4 4"], grid: Grid
    ) -> tuple[Int[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
        """Return the first face that each pixel's ray meets, from either side, and its z-depth [m].

        Where a ray meets nothing, the result is `NO_FACE` and inf.
        """
        ...

    def votes(
        self, T_world_cam: Float[np.ndarray, "p 4 4"], grid: Grid, tolerance_m: float
    ) -> Float[np.ndarray, " p"]:
        """Return the evidence for each pose, summed over the measured pixels.

        A pixel counts 1 if its depth agrees (falling to 0 over `tolerance_m`), -1 if its depth is
        behind a face, so that the ray would pass through the face, and else 0.
        """
        ...


def height_over(
    shape: BinShape, point: Float[np.ndarray, "*n 3"], face: Int[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Return the signed distance [m] of points from their face's plane; visible side positive."""
    return (shape.normal[face] * point).sum(axis=-1) - shape.offset_m[face]


def is_floor(shape: BinShape) -> Bool[np.ndarray, " f"]:
    """Return a mask of the faces of the inner floor."""
    return np.array(shape.names)[shape.surface] == "floor"
