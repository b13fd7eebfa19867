"""Artefacts to measure (planes, spheres and ball bars), and their positions in a rig's volume.

All positions are in the camera frame. A point is in the volume if the camera sees it, the projector
illuminates it, and its depth is in the working range.

Leaves out: holders and fixtures. The artefacts are perfect diffusers and float in the dark.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...base.frames import pixel_grid, transform_points
from ...rig.optics import project, rays
from ...rig.pair import Rig
from ...world.parts import Material
from ...world.scene import Quad, Sphere

EDGE_PX = 2.0  # least distance of artefacts from the edges of both pictures
RANGE_MARGIN = 0.03  # share of the working range that stays free at both ends, because of noise
DEPTHS = 41  # number of depths at which the common field is searched
FIELD_GRID_PX = (48, 64)
FACING_POINTS = 400  # number of points on a sphere, of which about half face the camera
CLEARANCE = 1.1  # least angle between spheres, as a multiple of the sum of their angular radii
SHRINKING = np.arange(1.0, -0.01, -0.05)  # scales that move a sphere to the middle until it fits
BAR_SHARES = np.arange(0.6, 0.09, -0.02)  # tried lengths of bars, as shares of the diagonal
PLANE_HALF = 8.0  # half the edge of a plane as a multiple of its depth, so that it fills the fields


@dataclass(frozen=True, slots=True, kw_only=True)
class Volume:
    """The working volume: the depths at which both devices have a common field, and its size.

    `diagonal_m` is the diagonal of the smallest box along the camera's axes that contains the
    common fields at all depths.
    """

    near_m: float
    far_m: float
    diagonal_m: float

    def depth_m(self, share: float) -> float:
        """Return the depth at a share of the range between the margins; 0 is near, 1 is far."""
        span_m = self.far_m - self.near_m
        return self.near_m + span_m * (RANGE_MARGIN + share * (1 - 2 * RANGE_MARGIN))


def working_volume(rig: Rig) -> Volume:
    """Return the part of the working range in which camera and projector have a common field.

    Raises:
        ValueError: there is no common field.
    """
    depth_m = np.linspace(rig.near_m, rig.far_m, DEPTHS)
    fields = [(z, common_rectangle_m(rig, z)) for z in depth_m.tolist()]
    shared = [(z, field) for z, field in fields if field is not None]
    if len(shared) < 2:
        raise ValueError(
            f"camera and projector of rig {rig.name} have no common field of view between "
            f"{rig.near_m} and {rig.far_m} m: check T_cam_proj and the working range"
        )
    low = np.min([field[0] for _, field in shared], axis=0)
    high = np.max([field[1] for _, field in shared], axis=0)
    near_m, far_m = shared[0][0], shared[-1][0]
    return Volume(
        near_m=near_m, far_m=far_m, diagonal_m=math.hypot(*(high - low).tolist(), far_m - near_m)
    )


def common_rectangle_m(
    rig: Rig, z_m: float
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]] | None:
    """Return opposite corners (x, y) of a rectangle at depth `z_m` that both devices cover.

    The rectangle is the bounding box of the common field, shrunk until it fits; None if it cannot.
    """
    point = z_m * rays(rig.camera, _grid_px(rig))
    inside = in_view(rig, point)
    if not inside.any():
        return None
    low, high = point[inside][:, :2].min(axis=0), point[inside][:, :2].max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    border = circle / np.abs(circle).max(axis=-1, keepdims=True)
    for scale in np.arange(1.0, 0.04, -0.02):
        outline = np.column_stack([middle + scale * half * border, np.full(len(border), z_m)])
        if in_view(rig, outline).all():
            return middle - scale * half, middle + scale * half
    return None


def in_view(rig: Rig, point: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Return whether points are in the fields of camera and projector; depth is not checked."""
    in_camera = _in_picture(project(rig.camera, point), rig.camera)
    lit = project(rig.projector, transform_points(rig.T_proj_cam, point))
    return in_camera & _in_picture(lit, rig.projector)


def plane(z_m: float, *, tilt_rad: float, azimuth_rad: float, material: Material) -> Quad:
    """Return a plane through (0, 0, z) whose front faces the camera.

    At tilt 0, it is perpendicular to the camera's axis. It is tilted about the direction in the x-y
    plane at `azimuth_rad` from x. Azimuth 0 tilts it about x; azimuth pi is the opposite tilt.
    """
    axis = np.array([math.cos(azimuth_rad), math.sin(azimuth_rad), 0.0])
    across = np.cross(axis, [0.0, 0.0, 1.0])  # in the untilted plane, perpendicular to the axis
    sloped = math.cos(tilt_rad) * across + math.sin(tilt_rad) * np.array([0.0, 0.0, 1.0])
    half_m = PLANE_HALF * z_m
    return Quad(
        center_m=(0.0, 0.0, z_m),
        half_u_m=tuple((half_m * axis).tolist()),
        half_v_m=tuple((half_m * sloped).tolist()),
        material=material,
    )


def sphere_centre_m(
    rig: Rig, volume: Volume, at: tuple[float, float, float], radius_m: float
) -> Float[np.ndarray, "3"]:
    """Return the centre of a sphere in the volume, as close to a wanted position as possible.

    Args:
        at: wanted position: -1 to 1 across the field (u, v), and 0 (near) to 1 (far) in depth.

    Raises:
        ValueError: the sphere is too large for the volume.
    """
    near_m, far_m = volume.depth_m(0.0) + radius_m, volume.depth_m(1.0) - radius_m
    z_m = near_m + at[2] * (far_m - near_m)
    field = common_rectangle_m(rig, z_m) if near_m <= far_m else None
    if field is not None:
        middle, half = (field[0] + field[1]) / 2, (field[1] - field[0]) / 2
        for scale in SHRINKING:
            centre = np.append(middle + scale * half * at[:2], z_m)
            if sphere_fits(rig, volume, centre, radius_m):
                return centre
    raise ValueError(
        f"a sphere of {2e3 * radius_m:.1f} mm does not fit into the volume of {rig.name} at {at}: "
        "camera and projector share too small a field there"
    )


def sphere_fits(
    rig: Rig, volume: Volume, centre_m: Float[np.ndarray, "3"], radius_m: float
) -> bool:
    """Return whether the side of a sphere that faces the camera is completely in the volume."""
    golden = np.arange(FACING_POINTS) * (math.pi * (3 - math.sqrt(5)))
    height = np.linspace(-1, 1, FACING_POINTS)
    ring = np.sqrt(1 - height**2)
    normal = np.stack([ring * np.cos(golden), ring * np.sin(golden), height], axis=-1)
    facing = normal[normal @ centre_m < 0]
    z_m = centre_m[2]
    in_range = volume.near_m <= z_m - radius_m and z_m + radius_m <= volume.far_m
    return bool(in_range and in_view(rig, centre_m + radius_m * facing).all())


@dataclass(frozen=True, slots=True, kw_only=True)
class BallBar:
    """Two spheres at a known distance."""

    name: str
    ends_m: Float[np.ndarray, "2 3"]
    radius_m: float

    def __post_init__(self) -> None:
        self.ends_m.flags.writeable = False

    @property
    def length_m(self) -> float:
        return float(np.linalg.norm(self.ends_m[1] - self.ends_m[0]))


BAR_DIRECTIONS = {
    "space diagonal 1": ((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)),
    "space diagonal 2": ((1.0, -1.0, 0.0), (-1.0, 1.0, 1.0)),
    "space diagonal 3": ((-1.0, 1.0, 0.0), (1.0, -1.0, 1.0)),
    "space diagonal 4": ((1.0, 1.0, 0.0), (-1.0, -1.0, 1.0)),
    "along x": ((-1.0, 0.0, 0.5), (1.0, 0.0, 0.5)),
    "along y": ((0.0, -1.0, 0.5), (0.0, 1.0, 0.5)),
    "diagonal of x and z": ((-1.0, 0.0, 0.0), (1.0, 0.0, 1.0)),
}


def ball_bars(rig: Rig, volume: Volume, *, radius_m: float) -> tuple[BallBar, ...]:
    """Return the longest ball bar that fits in all seven positions about the volume's centre.

    Raises:
        ValueError: no length down to a tenth of the volume's diagonal fits.
    """
    middle = sphere_centre_m(rig, volume, (0.0, 0.0, 0.5), radius_m)
    directions = {}
    for name, ends in BAR_DIRECTIONS.items():
        first, second = (sphere_centre_m(rig, volume, end, radius_m) for end in ends)
        directions[name] = (second - first) / np.linalg.norm(second - first)
    for share in BAR_SHARES:
        half_m = share * volume.diagonal_m / 2
        bars = tuple(
            BallBar(
                name=name,
                ends_m=np.stack([middle - half_m * along, middle + half_m * along]),
                radius_m=radius_m,
            )
            for name, along in directions.items()
        )
        fit = (sphere_fits(rig, volume, end, radius_m) for bar in bars for end in bar.ends_m)
        if all(fit) and all(clear(rig, bar.ends_m, radius_m) for bar in bars):
            return bars
    raise ValueError(
        f"no ball bar of {BAR_SHARES[-1]:.0%} of the diagonal fits into the volume of {rig.name}"
    )


def clear(rig: Rig, centre_m: Float[np.ndarray, "n 3"], radius_m: float) -> bool:
    """Return whether no sphere hides part of another from the camera or from the projector."""
    for eye in (np.zeros(3), rig.T_cam_proj[:3, 3]):
        way = centre_m - eye
        distance = np.linalg.norm(way, axis=-1)
        angular_rad = np.arcsin(np.minimum(radius_m / distance, 1.0))
        for i, j in itertools.combinations(range(len(way)), 2):
            between = way[i] @ way[j] / (distance[i] * distance[j])
            apart_rad = math.acos(min(between, 1.0))
            if apart_rad < CLEARANCE * (angular_rad[i] + angular_rad[j]):
                return False
    return True


def grouped(rig: Rig, centre_m: Float[np.ndarray, "n 3"], radius_m: float) -> list[list[int]]:
    """Return groups of spheres that can share a scene, so that few scenes are rendered.

    Each sphere joins the first scene with spheres at its depth (for one exposure) in which no
    sphere hides another.
    """
    scenes: list[list[int]] = []
    for index, centre in enumerate(centre_m):
        for scene in scenes:
            same_depth = abs(centre[2] - centre_m[scene[0], 2]) < radius_m
            if same_depth and clear(rig, centre_m[[*scene, index]], radius_m):
                scene.append(index)
                break
        else:
            scenes.append([index])
    return scenes


def spheres(
    centre_m: Float[np.ndarray, "n 3"], radius_m: float, material: Material
) -> tuple[Sphere, ...]:
    """Return spheres of equal radii as surfaces for a scene."""
    return tuple(
        Sphere(center_m=tuple(centre.tolist()), radius_m=radius_m, material=material)
        for centre in centre_m
    )


def _grid_px(rig: Rig) -> Float[np.ndarray, "h w 2"]:
    """Return a grid of positions over the camera's picture, including its borders."""
    rows, columns = FIELD_GRID_PX
    size = np.array([rig.camera.width_px, rig.camera.height_px])
    share = pixel_grid(rows, columns) / [columns - 1, rows - 1]
    return EDGE_PX + share * (size - 1 - 2 * EDGE_PX)


def _in_picture(pixel: Float[np.ndarray, "*n 2"], optics) -> Bool[np.ndarray, "*n"]:
    size = np.array([optics.width_px, optics.height_px])
    slack = 1e-6
    low, high = EDGE_PX - slack, size - 1 - EDGE_PX + slack
    with np.errstate(invalid="ignore"):  # Outside the range of the lens model, pixels are NaN.
        return np.all((pixel >= low) & (pixel <= high), axis=-1)
