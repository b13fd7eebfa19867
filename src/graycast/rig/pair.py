"""A camera and a projector with fixed relative pose: presets, working range and placement."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated

import numpy as np
from jaxtyping import Float, UInt8
from pydantic import AfterValidator, Field

from ..base import array_types as arrays
from ..base.frames import (
    axis_rotation,
    inverse,
    is_rigid,
    look_at,
    pixel_grid,
    rigid,
    transform_points,
)
from ..base.public_value import public_value
from ..base.settings import Level, Positive, Share, Vector, check_fields
from .former_names import current_name
from .optics import Optics, in_picture, project, rays
from .pattern import AXES, Axis
from .shelf import NAMES, no_rig, shelf_entry


def _rising(response: tuple[float, ...]) -> tuple[float, ...]:
    if not 2 <= len(response) <= 256 or not (np.diff(response) > 0).all():
        raise ValueError("give 2 to 256 values, each above the last")
    if (response[0], response[-1]) != (0.0, 1.0):
        raise ValueError(
            "it must start at 0 and end at 1, relative to white: state the light of black with "
            "contrast_ratio"
        )
    return response


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """One camera and one projector.

    `T_cam_proj` maps projector coordinates to camera coordinates [m]. A white projector pixel has
    the radiant intensity `intensity_w_sr` [W/sr] in every direction of its field, divided among the
    red, green and blue bands by `band_weights`. The measuring camera is monochrome and has a filter
    that passes only the bands in which the projector emits light.

    `response` is sampled at equal steps of grey level from 0 to 255 and linear between them. Every
    picture contains the projector's black level, which is white divided by `contrast_ratio`.
    `speckle_contrast` is the ratio of standard deviation to mean of the light of a rough surface:
    up to 1 for a laser, 0.71 if the surface depolarises it. `speckle_volume` is explained in
    `speckle.material_contrast`. `line_noise` is the relative standard deviation of the light of
    each projected line in each picture.

    Leaves out: any spectrum within a band; a response that depends on place, time or the picture.
    """

    name: Annotated[
        str, Field(min_length=1, description="Name of the rig in reports and datasets.")
    ]
    camera: Optics
    projector: Optics
    T_cam_proj: arrays.FloatArray_4_4
    near_m: Annotated[Positive, Field(description="Nearest depth of the working range in metres.")]
    far_m: Annotated[Positive, Field(description="Farthest depth of the working range in metres.")]
    intensity_w_sr: Annotated[
        Positive, Field(description="Radiant intensity of a white projector pixel [W/sr].")
    ] = 10.0
    band_weights: Annotated[
        Vector,
        Field(
            description="Shares of red, green and blue in the projector's light; their sum is 1."
        ),
    ] = (1 / 3, 1 / 3, 1 / 3)
    picture_level: Annotated[
        Share,
        Field(
            description="Grey level of the projector while the colour picture is taken, from 0 "
            "to 1."
        ),
    ] = 0.0
    response: Annotated[
        tuple[float, ...],
        Field(
            description="Radiance of the projector at equally spaced grey levels, relative "
            "to white."
        ),
        AfterValidator(_rising),
    ] = (0.0, 1.0)
    contrast_ratio: Annotated[
        float,
        Field(
            gt=1,
            description="Ratio of the projector's white to its black; infinite if the key is "
            "absent.",
        ),
    ] = math.inf
    veil: Annotated[
        float,
        Field(
            ge=0,
            lt=1,
            description="Share of the light that the camera's lens spreads over the image as stray "
            "light.",
        ),
    ] = 0.0
    speckle_contrast: Annotated[
        Share,
        Field(
            description="Speckle contrast at a point of the sensor, on a black surface: 1 for a "
            "laser, 0 for an LED."
        ),
    ] = 0.0
    speckle_volume: Annotated[
        Level,
        Field(
            description="Reduction of the speckle contrast by scattering inside a white surface; 0 "
            "is no reduction."
        ),
    ] = 0.0
    speckle_unevenness: Annotated[
        Share,
        Field(
            description="Standard deviation of the natural logarithm of the speckle contrast "
            "between patches of a surface."
        ),
    ] = 0.0
    line_noise: Annotated[
        float,
        Field(ge=0, le=0.2, description="Noise of each projected line's light, as a share of it."),
    ] = 0.0
    line_noise_length_m: Annotated[
        Positive,
        Field(
            description="Distance along a projected line, on a surface in the middle of the "
            "working range, at which line noise has a correlation of 1/e. A line has "
            "one error from end to end if the key is absent."
        ),
    ] = math.inf

    @property
    def T_proj_cam(self) -> arrays.FloatArray_4_4:
        """Pose of the camera in projector coordinates: maps camera to projector points [m]."""
        return inverse(self.T_cam_proj)

    def __post_init__(self) -> None:
        check_fields(self)
        self.T_cam_proj.flags.writeable = False
        if not is_rigid(self.T_cam_proj):
            raise ValueError("T_cam_proj is not a rotation and a translation: check R and T")
        if not 0 < self.near_m < self.far_m:
            span = f"near_m {self.near_m}, far_m {self.far_m}"
            raise ValueError(f"working range is {span}; it needs 0 < near_m < far_m")
        if self.baseline_m < 1e-6:
            raise ValueError(
                "camera and projector have the same position: give them a baseline, which "
                "triangulation needs"
            )
        if self.baseline_m > 10:
            raise ValueError(
                f"baseline is {self.baseline_m:.3g} m: give T in metres, not in millimetres"
            )
        if min(self.band_weights) < 0 or abs(sum(self.band_weights) - 1) > 1e-6:
            raise ValueError(
                f"band_weights are {self.band_weights}; give the shares of R, G and B, whose sum "
                "is 1"
            )

    @property
    def baseline_m(self) -> float:
        return float(np.linalg.norm(self.T_cam_proj[:3, 3]))

    @property
    def passed_bands(self) -> tuple[float, float, float]:
        """Transmission of the measuring camera's filter for red, green and blue, each 0 or 1."""
        red, green, blue = (float(weight > 0) for weight in self.band_weights)
        return red, green, blue

    @property
    def axes_angle_rad(self) -> float:
        """Angle between the two optical axes, which is the sum of the two toe-in angles."""
        return float(np.arccos(np.clip(self.T_cam_proj[2, 2], -1.0, 1.0)))


def emission(rig: Rig, level: UInt8[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return the light of the projector at grey levels, relative to white, without black level."""
    return _emission_table(rig)[level]


def grey_levels(rig: Rig, share: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """Return the grey level whose `emission` is nearest to each share of white."""
    table = _emission_table(rig)
    return np.searchsorted((table[1:] + table[:-1]) / 2, share).astype(np.uint8)


def _emission_table(rig: Rig) -> Float[np.ndarray, "256"]:
    return np.interp(np.arange(256), np.linspace(0, 255, len(rig.response)), rig.response)


PRESETS = NAMES
# Sensor pixels along each side of an image pixel. Real cameras also bin pixels to be faster.
BINNING: Mapping[str, int] = MappingProxyType({"small": 4, "low": 2, "full": 1})
RESOLUTIONS = tuple(BINNING)


def preset_rig(name: str, resolution: str = "low") -> Rig:
    """Return a preset rig, with sharp lenses.

    `paper` models the scanner of a publication, which names the PhoXi M and L but states neither
    intrinsics nor resolution. It has the camera and baseline of a PhoXi M, and a white projector.

    Args:
        name: one of `PRESETS`, or the name of a preset in an earlier version.
        resolution: 'full' has all pixels of the camera, 'low' a quarter of them and 'small' a
            sixteenth; for a PhoXi these are 2064 x 1544, 1032 x 772 and 516 x 386 pixels.

    Raises:
        ValueError: there is no such preset or resolution.
    """
    if resolution not in RESOLUTIONS:
        raise ValueError(f"no resolution {resolution!r}: choose one of {', '.join(RESOLUTIONS)}")
    name = current_name(name)
    if name == "paper":
        phoxi = preset_rig("like-phoxi-m", resolution)
        return replace(phoxi, name=name, band_weights=(1 / 3, 1 / 3, 1 / 3), picture_level=0.25)
    if name not in PRESETS:
        raise ValueError(no_rig(name))
    entry = shelf_entry(name)
    return Rig(
        name=name,
        camera=entry.camera.optics(BINNING[resolution]),
        projector=entry.projector.optics(),
        T_cam_proj=entry.T_cam_proj,
        near_m=entry.near_m,
        far_m=entry.far_m,
        band_weights=entry.band_weights,
    )


def depth_per_line_m(rig: Rig, z_m: float, axis: Axis) -> float:
    """Return the change of depth [m] per projector column (or row) on the camera's axis at `z_m`.

    It is NaN if the projector does not light that point, and inf if the column (or row) does not
    change with depth. A numerical derivative is used, so any pose and distortion is allowed.
    """
    across = AXES.index(axis)
    step_m = 1e-4 * z_m
    centre = np.array([[rig.camera.cx_px, rig.camera.cy_px]])
    ray = rays(rig.camera, centre)[0]
    point = np.stack([ray * (z_m - step_m), ray * (z_m + step_m)])
    T_proj_cam = rig.T_proj_cam
    line = project(rig.projector, transform_points(T_proj_cam, point))[:, across]
    size_px = (rig.projector.width_px, rig.projector.height_px)[across]
    lit = -0.5 <= line.mean() <= size_px - 0.5
    if not lit:
        return math.nan
    shift = float(abs(line[1] - line[0]))  # 0 if the baseline is parallel to the lines
    return 2 * step_m / shift if shift > 0 else math.inf


def common_depths_m(
    camera: Optics,
    projector: Optics,
    T_cam_proj: Float[np.ndarray, "4 4"],
    depth_m: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " m"]:
    """Return the depths at which the fields of camera and projector overlap.

    Only 33 x 33 camera pixels are tested, so an overlap of less than 3 % may be missed.
    """
    grid = pixel_grid(33, 33) / 32 * [camera.width_px - 1, camera.height_px - 1]
    ray = rays(camera, grid)
    visible = []
    for z_m in depth_m:
        place_px = project(projector, transform_points(inverse(T_cam_proj), z_m * ray))
        visible.append(in_picture(projector, place_px).any())
    return depth_m[np.array(visible, dtype=bool)]


def place(
    rig: Rig,
    *,
    target_m: arrays.FloatArray_3,
    distance_m: float,
    tilt_rad: float,
    azimuth_rad: float,
) -> arrays.FloatArray_4_4:
    """Return `T_world_cam` of a rig that hangs above a target and points at it.

    The middle of the baseline is `distance_m` from the target. The bisector of the two pictures'
    middle rays points at the target, `tilt_rad` from the vertical. At azimuth 0 the baseline is
    parallel to world x and a tilted rig is on the -y side; the azimuth turns the rig about world z.
    """
    turn = axis_rotation("z", azimuth_rad)
    away = turn @ np.array([0.0, -np.sin(tilt_rad), np.cos(tilt_rad)])
    down = turn @ np.array([0.0, -np.cos(tilt_rad), -np.sin(tilt_rad)])
    T_world_rig = look_at(np.asarray(target_m) + distance_m * away, np.asarray(target_m), down)
    return T_world_rig @ inverse(frame_in_camera(rig))


def frame_in_camera(rig: Rig) -> Float[np.ndarray, "4 4"]:
    """Return `T_cam_rig`, the pose of the rig's own frame in the camera frame.

    Its origin is in the middle of the baseline. z is the bisector of the devices' middle rays
    (the optical axes, if there is no lens shift), and y is as near to the camera's y as possible.
    """
    bisector = _middle_ray(rig.camera) + rig.T_cam_proj[:3, :3] @ _middle_ray(rig.projector)
    middle = rig.T_cam_proj[:3, 3] / 2
    return look_at(middle, middle + bisector, np.array([0.0, 1.0, 0.0]))


def aimed(rig: Rig, *, baseline_m: float, distance_m: float) -> Rig:
    """Return the rig with another baseline and with both devices aimed at one target.

    The target is on the former bisector of their middle rays, `distance_m` from the middle of the
    baseline. The working range does not change, because it depends on lenses and focus.
    """
    T_rig_cam = inverse(frame_in_camera(rig))
    target = np.array([0.0, 0.0, distance_m])
    turned = []
    for optics, T in ((rig.camera, T_rig_cam), (rig.projector, T_rig_cam @ rig.T_cam_proj)):
        eye = baseline_m / rig.baseline_m * T[:3, 3]
        start = T[:3, :3] @ _middle_ray(optics)
        turned.append(rigid(_least_turn(start, target - eye) @ T[:3, :3], eye))
    return replace(rig, T_cam_proj=inverse(turned[0]) @ turned[1])


def _least_turn(
    start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3"]:
    """Return the rotation by the smallest angle, below 180 degrees, from one direction to another.

    Rodrigues' formula is `I + K + K K / (1 + c)`, where K is the matrix of the cross product of the
    two unit directions and c is their scalar product.
    """
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    x, y, z = np.cross(a, b)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + K + K @ K / (1 + a @ b)


def _middle_ray(optics: Optics) -> Float[np.ndarray, "3"]:
    """Return the unit direction of the ray through the middle of a device's picture.

    Devices are aimed by this ray: with lens shift, a projector's optical axis may miss its picture.
    """
    middle = np.array([[(optics.width_px - 1) / 2, (optics.height_px - 1) / 2]])
    ray = rays(optics, middle)[0]
    return ray / np.linalg.norm(ray)


def best_depth_m(rig: Rig) -> float:
    """Return the depth at which the two middle rays are closest, clipped to the working range."""
    camera, projector = _middle_ray(rig.camera), rig.T_cam_proj[:3, :3] @ _middle_ray(rig.projector)
    origin = rig.T_cam_proj[:3, 3]
    # s and t are at the closest points of the lines s * camera and origin + t * projector.
    c = camera @ projector
    if 1 - c * c < 1e-12:
        return 0.5 * (rig.near_m + rig.far_m)
    s = (origin @ camera - c * (origin @ projector)) / (1 - c * c)
    return float(np.clip(s * camera[2], rig.near_m, rig.far_m))


def standoff_m(rig: Rig) -> float:
    """Return the distance from the middle of the baseline to the best working point.

    This point is on the camera's middle ray, at the depth `best_depth_m`.
    """
    ray = _middle_ray(rig.camera)
    point = best_depth_m(rig) / ray[2] * ray
    return float(np.linalg.norm(point - rig.T_cam_proj[:3, 3] / 2))
