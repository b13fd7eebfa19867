"""Share of the parts' surface that each view measures, and the order in which views add most.

The surface consists of the parts' models at their true poses, as points for equal areas. A point is
visible if at least one camera sees it. It is measured by a view if the view sees it and has a
correct depth at its pixel.
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

WRONG_M = 2e-3  # A depth farther from the truth is wrong.
WRONG = 252  # A value in addition to a dataset's reasons: the depth exists, but is wrong.
# A model may differ from the truth by this in a pixel: surfaces curve, and parts penetrate others.
_SLACK_M = 0.5e-3
_SLOPE = 0.2  # The tolerance grows with the size of a pixel on the surface.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewTruth:
    """Ground truth of a simulated view: z [m], NaN without a surface; instance, -1 for no part."""

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
    """Return points spread over all instances in proportion to their areas, without randomness."""
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
    """Return why a view lacks each point: its reason, or HIDDEN, OUTSIDE, WRONG; 0 if it has depth.

    A point is visible if the truth at its pixel has the same instance and is on the point's plane.
    """
    camera = view.camera
    T_cam_world = inverse(view.T_world_cam)
    at = transform_points(T_cam_world, surface.point_m)
    row_column, inside = pixels_of(camera, at)
    pixel = tuple(row_column.T)
    # The true point of the pixel is on the same ray as the measured one.
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

    Among views that add equally many points, the first is taken. No choice of equally many views
    has more than 1 / (1 - 1/e) = 1.58 times as many points.

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
