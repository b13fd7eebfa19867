"""Points on the surface of a heap's parts, and the visibility of these points.

The points belong to the heap, not to a scanner, so all settings are compared at the same points.
Visibility is computed without a renderer, by rasterising all meshes as seen from an eye.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.frames import inverse, look_at, transform_points
from ...rig.meshdepth import rasterize
from ...rig.optics import Optics, pinhole, pixels_of
from ...world.parts import Mesh
from ...world.scene import Bin, Layout, Scene, bin_mesh, bin_of
from ..merge.adding import surface_of

LEAST_PX = 1000  # least length of the longer side of the picture in which visibility is computed
SLACK_M = 0.5e-3  # tolerance for parts that penetrate each other and for inexact meshes
# number of directions in each ring of the cone, and their tilt as a share of the cone's angle
RINGS = ((1, 0.0), (6, 0.5), (12, 1.0))


class Visibility(IntEnum):
    """Visibility of a point from an eye (camera or projector), or the reason why it is hidden."""

    VISIBLE = 0
    OUTSIDE = 1  # The point is not in the picture.
    BY_PARTS = 2  # Another part hides the point, or the point faces away from the eye.
    BY_BIN = 3


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class HeapSurface:
    """Points on the surfaces of placed parts, in the world frame, each for about the same area.

    `weight` is the visibility of a point from above: the mean, over directions in a cone, of the
    cosine of incidence (0 where the point is hidden). Points with a weight above 0 are the open
    surface. `instance` is the index of the point's part in the layout.
    """

    point_m: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    instance: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]

    @property
    def opened(self) -> Bool[np.ndarray, " n"]:
        return self.weight > 0

    def __post_init__(self) -> None:
        for array in (self.point_m, self.normal, self.instance, self.weight):
            array.flags.writeable = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacles:
    """All surfaces that can hide a point, as one mesh that begins with the faces of the bin."""

    mesh: Mesh
    bin_faces: int


def spread_surface(scene: Scene, layout: Layout, *, points: int, cone_deg: float) -> HeapSurface:
    """Distribute points over the parts of a heap, and weight them by their visibility from above.

    The points are not random, so a heap has the same points in every setting.
    """
    meshes = [scene.parts[kind].mesh for kind in layout.part_index]
    surface = surface_of(meshes, list(layout.T_world_part), points=points)
    point_m, normal = surface.point_m, surface.normal
    box, obstacles = bin_of(scene), obstacles_of(scene, layout)
    eyes = _cone(box, cone_deg)
    weight = np.zeros(len(point_m))
    for eye, T_world_eye in eyes:
        visible = sight(obstacles, eye, T_world_eye, point_m, normal) == Visibility.VISIBLE
        weight += np.where(visible, -(normal @ T_world_eye[:3, 2]), 0.0).clip(0.0) / len(eyes)
    return HeapSurface(point_m=point_m, normal=normal, instance=surface.instance, weight=weight)


def obstacles_of(scene: Scene, layout: Layout) -> Obstacles:
    box = bin_mesh(bin_of(scene))
    meshes = [scene.parts[kind].mesh for kind in layout.part_index]
    vertices, faces, first = [box.vertices_m], [box.faces], len(box.vertices_m)
    for mesh, T in zip(meshes, layout.T_world_part, strict=True):
        vertices.append(transform_points(T, mesh.vertices_m.astype(np.float64)))
        faces.append(mesh.faces + first)
        first += len(mesh.vertices_m)
    whole = Mesh(vertices_m=np.concatenate(vertices), faces=np.concatenate(faces))
    return Obstacles(mesh=whole, bin_faces=len(box.faces))


def sight(
    obstacles: Obstacles,
    optics: Optics,
    T_world_eye: Float[np.ndarray, "4 4"],
    point_m: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
) -> Int[np.ndarray, " n"]:
    """Return the `Visibility` of points on the parts from a camera or a projector.

    A point is hidden if the nearest face in its pixel is closer than the point by more than
    `SLACK_M`, both at the pixel's centre and at the intersection of the face's plane with the
    point's ray. The picture has at least `LEAST_PX`, because edges may be wrong by half a pixel.
    """
    eye = _enlarged(optics)
    T_eye_world = inverse(T_world_eye)
    vertices = transform_points(T_eye_world, obstacles.mesh.vertices_m.astype(np.float64))
    face, z_m = rasterize(vertices, obstacles.mesh.faces, eye).over(eye)
    at = transform_points(T_eye_world, point_m)
    pixel, inside = pixels_of(eye, at)
    visibility = np.full(len(point_m), int(Visibility.OUTSIDE))
    row, column = pixel[inside].T
    hit, own = face[row, column], at[inside]
    nearest_m = np.maximum(z_m[row, column], _on_plane(vertices, obstacles, hit, own))
    hidden = (hit >= 0) & (own[:, 2] - nearest_m > SLACK_M)
    by_bin = hidden & (hit < obstacles.bin_faces)
    towards = -(own * (normal[inside] @ T_eye_world[:3, :3].T)).sum(axis=-1)
    # A point that faces away is hidden by its own part, whether or not the bin hides it, too.
    cases = [by_bin & (towards > 0), hidden | (towards <= 0)]
    visibility[inside] = np.select(
        cases, [int(Visibility.BY_BIN), int(Visibility.BY_PARTS)], int(Visibility.VISIBLE)
    )
    return visibility


def _on_plane(
    vertices: Float[np.ndarray, "v 3"],
    obstacles: Obstacles,
    hit: Int[np.ndarray, " n"],
    point: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """Return z where each point's ray meets its face's plane: `z = z_point (m . a) / (m . p)`."""
    a, b, c = np.moveaxis(vertices[obstacles.mesh.faces[hit]], 1, 0)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = point[:, 2] * (normal * a).sum(axis=-1) / (normal * point).sum(axis=-1)
    return np.where(np.isfinite(z), z, np.inf)


def _enlarged(optics: Optics) -> Optics:
    """Return optics with the same view and a picture of at least `LEAST_PX`."""
    times = -(-LEAST_PX // max(optics.width_px, optics.height_px))
    return replace(
        optics,
        width_px=times * optics.width_px,
        height_px=times * optics.height_px,
        fx_px=times * optics.fx_px,
        fy_px=times * optics.fy_px,
        cx_px=times * (optics.cx_px + 0.5) - 0.5,
        cy_px=times * (optics.cy_px + 0.5) - 0.5,
    )


def _cone(box: Bin, cone_deg: float) -> list[tuple[Optics, Float[np.ndarray, "4 4"]]]:
    """Return distant eyes above the bin, in all directions up to `cone_deg` from the vertical."""
    low, high = box.bounds_m
    middle, radius_m = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    away_m = 10 * radius_m  # From far away, the rays are nearly parallel.
    f_px = 0.5 * LEAST_PX * away_m / (1.15 * radius_m)  # Parts may stick out at the top.
    eye = pinhole(LEAST_PX, LEAST_PX, f_px)
    eyes = []
    for count, share in RINGS if cone_deg > 0 else RINGS[:1]:
        lean = np.radians(share * cone_deg)
        for turn in 2 * np.pi * np.arange(count) / count:
            side = np.array([np.cos(turn), np.sin(turn), 0.0])
            away = np.sin(lean) * side + np.array([0.0, 0.0, np.cos(lean)])
            down = np.cos(lean) * side - np.array([0.0, 0.0, np.sin(lean)])
            eyes.append((eye, look_at(middle + away_m * away, middle, down)))
    return eyes
