"""Find the share of the parts' surface that each view measures, and the best order of views.

The surface consists of the parts' models at their true poses, as points for equal areas. A point is
visible if at least one camera sees it. A view measures a point if it sees the point and has a
correct depth at the point's pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ...base.frames import inverse, transform_points
from ...rig.optics import pixels_of
from ...world.parts import Mesh
from ...world.parts.sampling import spread_points
from .fuse import HIDDEN, OUTSIDE
from .view import MeasuredView, Points

WRONG_M = 2e-3  # Depth that deviates more from the truth is wrong.
WRONG = 252  # number in addition to the dataset's reasons: the depth exists, but is wrong
# tolerance between a model and the true depth in a pixel; surfaces curve, and parts penetrate
_SLACK_M = 0.5e-3
_SLOPE = 0.2  # growth of this tolerance with the size of a pixel on the surface


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewTruth:
    """Truth of a simulated view: z [m] (NaN without a surface), instance (-1 for no part)."""

    depth_m: Float[np.ndarray, "h w"]
    instance: Int[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        self.depth_m.flags.writeable = False
        self.instance.flags.writeable = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SurfacePoints:
    """Points on placed parts, in the world frame, each for the same area."""

    point_m: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    instance: Int[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


def surface_of(
    meshes: Sequence[Mesh], T_world_part: Sequence[Float[np.ndarray, "4 4"]], *, points: int
) -> SurfacePoints:
    """Return points that are spread evenly over all instances, without randomness."""
    area = [float(mesh.face_area_m2.sum()) for mesh in meshes]
    place, normal, instance = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for number, (mesh, T) in enumerate(zip(meshes, T_world_part, strict=True)):
        own, facing = spread_points(mesh, max(1, round(points * area[number] / sum(area))))
        place.append(transform_points(T, own))
        normal.append(facing @ T[:3, :3].T)
        instance.append(np.full(len(own), number))
    return SurfacePoints(
        point_m=np.concatenate(place),
        normal=np.concatenate(normal),
        instance=np.concatenate(instance),
    )


def why_not(
    surface: SurfacePoints, view: MeasuredView, points: Points, truth: ViewTruth
) -> UInt8[np.ndarray, " n"]:
    """Return the reason why a view lacks each point (HIDDEN, OUTSIDE, WRONG, ...); 0 for depth.

    A point is visible if the truth at its pixel has the same instance and is on the point's plane.
    """
    camera = view.camera
    T_cam_world = inverse(view.T_world_cam)
    at = transform_points(T_cam_world, surface.point_m)
    row_column, inside = pixels_of(camera, at)
    pixel = tuple(row_column.T)
    # The pixel's true point is on the same ray as its measured point.
    eye, toward = view.T_world_cam[:3, 3], points.toward[pixel]
    along_m = truth.depth_m[pixel] / -(toward @ T_cam_world[2, :3])
    off_m = ((eye - along_m[:, None] * toward - surface.point_m) * surface.normal).sum(axis=-1)
    facing = (surface.normal * (eye - surface.point_m)).sum(axis=-1) > 0
    spacing_m = at[:, 2] / np.sqrt(camera.fx_px * camera.fy_px)
    visible = facing & (truth.instance[pixel] == surface.instance)
    visible &= np.abs(off_m) <= _SLACK_M + _SLOPE * spacing_m
    wrong = np.abs(view.depth_m[pixel] - truth.depth_m[pixel]) > WRONG_M
    cases = [~inside, ~visible, wrong]
    reasons = [np.uint8(OUTSIDE), np.uint8(HIDDEN), np.uint8(WRONG)]
    return np.select(cases, reasons, view.reason[pixel])


def best_order(has: Bool[np.ndarray, "views n"]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the order in which each view adds most to the views before it, and the points added.

    If several views add equally many points, the first of them is taken. No set of equally many
    views has more than 1 / (1 - 1/e) = 1.58 times as many points.

    Source: G. Nemhauser et al., "An analysis of approximations for maximizing submodular set
    functions", 1978.
    """
    left = np.ones(has.shape[1], dtype=bool)
    order: list[int] = []
    gains: list[int] = []
    while len(order) < len(has):
        gain = [-1 if i in order else int((row & left).sum()) for i, row in enumerate(has)]
        best = int(np.argmax(gain))
        order.append(best)
        gains.append(gain[best])
        left &= ~has[best]
    return tuple(order), tuple(gains)
