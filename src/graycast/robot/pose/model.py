"""The model of a part for pose searches, which is prepared only once."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base import array_types as arrays
from ...base.frames import rigid
from ...base.public_value import public_value
from ...world.parts import Mesh, Symmetry
from ...world.parts.sampling import dense_points, surface_points
from ...world.parts.symmetry import axis_rotations, motions
from .closest import Closest, OrientedPoints, closest
from .drawing import Facets
from .pairs import PairTable, pair_table

STEP = 0.05  # spacing of the points of pairs, and bin width of distances, as shares of the diameter
MOST_POINTS = 700  # The number of pairs grows with the square of the number of points.
DENSE_STEP = 0.008  # spacing of the points for ICP, as a share of the diameter
MOST_DENSE = 40_000


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class PoseModel:
    """The data of a part for the pose search, in the part's frame.

    Attributes:
        diameter_m: diameter of the ball around the box's centre that contains the vertices.
        points: sparse points, which form the pairs.
        pairs: table of the features of all pairs of `points`.
        surface: lookup of the nearest surface point for any point near the part.
        key_m: points that every rigid motion moves, except a motion of the symmetry.
        alike: the discrete motions that leave the part unchanged, the identity first.
        symmetry: all motions that leave the part unchanged.
    """

    facets: Facets
    diameter_m: float
    points: OrientedPoints
    pairs: PairTable
    surface: Closest
    key_m: arrays.FloatArray_k_3
    alike: arrays.FloatArray_s_4_4
    symmetry: Symmetry
    turns: arrays.FloatArray_t_4_4

    def __post_init__(self) -> None:
        surface, pairs = self.surface, self.pairs
        of_surface = (*surface.points, surface.low_m, surface.nearest)
        of_pairs = (*self.points, pairs.start, pairs.first, pairs.turn_rad)
        for array in (*self.facets, *of_surface, *of_pairs, self.key_m, self.alike):
            array.flags.writeable = False


def pose_model(mesh: Mesh, symmetry: Symmetry) -> PoseModel:
    """Return the model of a closed mesh; this takes about a second."""
    corners = mesh.bounds_m
    used = mesh.vertices_m[np.unique(mesh.faces)].astype(np.float64)
    middle = corners.mean(axis=0)
    diameter_m = 2 * float(np.linalg.norm(used - middle, axis=1).max())
    points = OrientedPoints(*surface_points(mesh, STEP * diameter_m, most=MOST_POINTS))
    dense = OrientedPoints(*dense_points(mesh, DENSE_STEP * diameter_m, most=MOST_DENSE))
    return PoseModel(
        facets=Facets(
            vertex=np.ascontiguousarray(mesh.vertices_m, dtype=np.float64),
            face=np.ascontiguousarray(mesh.faces),
            normal=mesh.face_normal,
        ),
        diameter_m=diameter_m,
        points=points,
        pairs=pair_table(points, STEP * diameter_m),
        surface=closest(dense, diameter_m),
        key_m=_keys(symmetry, middle, diameter_m),
        alike=motions(Symmetry(discrete=symmetry.discrete)),
        symmetry=symmetry,
        turns=np.stack([rigid(R, middle - R @ middle) for R in axis_rotations()]),
    )


def _keys(
    symmetry: Symmetry, middle: Float[np.ndarray, "3"], diameter_m: float
) -> Float[np.ndarray, "k 3"]:
    """Return two points on the axis of a rotational part, else the centre and one on each axis."""
    if symmetry.continuous:
        axis, offset = (np.array(one, dtype=np.float64) for one in symmetry.continuous[0])
        axis = axis / np.linalg.norm(axis)
        foot = offset + axis * (axis @ (middle - offset))
        return np.stack([foot - axis * diameter_m / 2, foot + axis * diameter_m / 2])
    return np.vstack([middle, middle + np.eye(3) * diameter_m / 2])
