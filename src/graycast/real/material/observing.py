"""The reflection that one scan observes: geometry and the projector's light per pixel."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...base import array_types as arrays
from ...base.frames import transform_points
from ...base.public_value import public_value
from ...camera.decode import CodeMap, Levels, Mark, Reason
from ...rig.optics import (
    Optics,
    corner_share,
    in_picture,
    mask_points,
    project,
    relative_illumination,
)
from ...rig.pair import Rig
from .normals import smooth_normals

LEAST_COSINE = 0.17  # Surfaces that either device sees at more than 80 degrees are left out.
SURE_SIGMAS = 5.0  # Darker pixels are left out.
MOST_NORMAL_SIGMA_RAD = 0.05  # Pixels with a less certain normal are left out.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Reflections:
    """Pixels of one surface: their directions, and their light without distance and vignetting.

    `light` is proportional to `f cos(theta)`, with the BSDF f and the angle between normal and
    projector. Where `clipped`, a picture is saturated, and the true light is at least `light`.
    `dark_share` and `saturated_share` count all pixels of the surface, with or without a normal:
    those that return no light, and those that saturate. They are 0 if no mask marks the surface.
    """

    normal: arrays.FloatArray_n_3
    to_camera: arrays.FloatArray_n_3
    to_projector: arrays.FloatArray_n_3
    light: arrays.FloatArray_n
    sigma: arrays.FloatArray_n
    clipped: arrays.BoolArray_n
    normal_sigma_rad: arrays.FloatArray_n
    area_px: arrays.FloatArray_n  # The number of pixels that determine the normal
    pixel: arrays.IntArray_n_2  # Row and column
    point_m: arrays.FloatArray_n_3  # Place in the camera's frame
    dark_share: float = 0.0
    saturated_share: float = 0.0

    def __len__(self) -> int:
        return len(self.light)

    @property
    def half_angle_rad(self) -> arrays.FloatArray_n:
        """The angle between the normal and the middle of both directions."""
        half = self.to_camera + self.to_projector
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        return np.arccos(np.clip((half * self.normal).sum(axis=-1), -1, 1))

    @property
    def light_cosine(self) -> arrays.FloatArray_n:
        return (self.normal * self.to_projector).sum(axis=-1)

    def part(self, index: arrays.IntArray_n) -> "Reflections":
        """Return the pixels with these numbers."""
        values = {name: getattr(self, name) for name in self.__slots__}
        return replace(self, **{k: v[index] for k, v in values.items() if np.ndim(v)})


def observe(
    rig: Rig,
    codes: CodeMap,
    depth_m: Float[np.ndarray, "h w"],
    direct: Float[np.ndarray, "h w"],
    levels: Levels,
    *,
    mask: Bool[np.ndarray, "h w"] | None = None,
    exposure: Float[np.ndarray, "h w"] | float = 1.0,
) -> Reflections:
    """Return the observations of the decoded and the saturated pixels in a mask.

    Args:
        depth_m: depth of each pixel; NaN where there is none.
        direct: the projector's direct light under a white picture [DN above offset]. It excludes
            light that is reflected repeatedly, unless that light has stripes itself, as in mirrors
            (see `camera.decode.separate`). Saturated pixels have the least light that saturates.
        mask: the pixels of one surface; None is all pixels.
        exposure: each pixel's exposure relative to a common exposure.
    """
    direct, shape = direct.astype(np.float64), direct.shape
    inside = np.ones(shape, dtype=bool) if mask is None else mask
    noise = np.sqrt(2 * (levels.floor_dn2 + levels.slope_dn * np.maximum(direct, 0)))
    saturated = codes.reason == Reason.SATURATED
    usable = saturated | (codes.reason == Reason.DECODED)
    mark = codes.mark
    clipped = saturated if mark is None else saturated | ((mark & Mark.CLIPPED) > 0)
    light = np.where(usable, direct, 0.0)
    return observe_picture(
        rig, depth_m, light, noise, inside=inside, clipped=clipped, exposure=exposure
    )


def observe_picture(
    rig: Rig,
    depth_m: Float[np.ndarray, "h w"],
    light: Float[np.ndarray, "h w"],
    noise: Float[np.ndarray, "h w"],
    *,
    inside: Bool[np.ndarray, "h w"],
    clipped: Bool[np.ndarray, "h w"],
    exposure: Float[np.ndarray, "h w"] | float = 1.0,
) -> Reflections:
    """Return the observations of a picture that only the scanner's white pattern lights.

    A picture includes light that other surfaces reflect, which makes the fit less certain than a
    stack does.

    Args:
        depth_m: depth of each pixel; NaN where there is none.
        light: the picture's light above black, proportional to radiance.
        noise: standard deviation of `light`.
        inside: the pixels of one surface.
        clipped: pixels whose true light is at least `light`.
        exposure: each pixel's exposure relative to a common exposure.
    """
    normals = smooth_normals(rig.camera, depth_m, inside)
    keep = inside & np.isfinite(normals.sigma_rad)
    keep &= (normals.sigma_rad <= MOST_NORMAL_SIGMA_RAD) & (light > SURE_SIGMAS * noise)
    point_m = mask_points(rig.camera, depth_m, keep)
    factor = np.broadcast_to(exposure, light.shape)[keep] * relative_illumination(rig.camera)[keep]
    factor = factor * _irradiance(rig, point_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        observations = Reflections(
            normal=normals.normal[keep],
            to_camera=_unit(-point_m),
            to_projector=_unit(rig.T_cam_proj[:3, 3] - point_m),
            light=light[keep] / factor,
            sigma=noise[keep] / factor,
            clipped=clipped[keep],
            normal_sigma_rad=normals.sigma_rad[keep],
            area_px=normals.area_px[keep],
            pixel=np.argwhere(keep),
            point_m=point_m,
        )
    facing = (observations.normal * observations.to_camera).sum(axis=-1)
    good = (facing > LEAST_COSINE) & (observations.light_cosine > LEAST_COSINE) & (factor > 0)
    return observations.part(np.flatnonzero(good))


def _irradiance(rig: Rig, point_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the projector's relative irradiance on a facing surface; 0 outside its picture."""
    own_m = transform_points(rig.T_proj_cam, point_m)
    distance2_m2 = np.square(own_m).sum(axis=-1)
    share = _projector_share(rig.projector, own_m, np.sqrt(distance2_m2))
    return share / distance2_m2


def _projector_share(
    projector: Optics, own_m: Float[np.ndarray, "n 3"], distance_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    place_px = project(projector, own_m)
    share = in_picture(projector, place_px).astype(np.float64)
    if projector.natural_vignetting:
        share *= own_m[:, 2] / distance_m
    if projector.falloff:
        share *= 1 - projector.falloff * np.nan_to_num(corner_share(projector, place_px))
    return share


def _unit(vector: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
