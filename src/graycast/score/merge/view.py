"""What one view measured, as fusing wants it: places, normals and noise, all in the world."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...base.frames import transform_points
from ...camera.crop import crop
from ...rig.optics import Optics, picture_rays

_WINDOW_PX = 2  # It is half the width of the windows in which planes are laid.
LEAST_COSINE = 0.2  # Where a surface is steeper to the ray, its normal's error counts, not noise.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredView:
    """One picture's depth and where it was taken from.

    Attributes:
        name: what tables call it.
        depth_m: z of the camera frame; NaN where nothing was measured.
        sigma_m: standard deviation of z; NaN where nothing was measured.
        reason: why there is no depth, as a dataset numbers it; 0 where there is one.
        color: 8-bit sRGB.
    """

    name: str
    camera: Optics
    T_world_cam: Float[np.ndarray, "4 4"]
    depth_m: Float[np.ndarray, "h w"]
    sigma_m: Float[np.ndarray, "h w"]
    reason: UInt8[np.ndarray, "h w"]
    color: UInt8[np.ndarray, "h w 3"]

    def __post_init__(self) -> None:
        size = (self.camera.height_px, self.camera.width_px)
        for name in ("depth_m", "sigma_m", "reason", "color"):
            array = getattr(self, name)
            if array.shape[:2] != size:
                raise ValueError(f"{self.name}: {name} is {array.shape}, its camera has {size}")
            array.flags.writeable = False
        if not (self.sigma_m[np.isfinite(self.depth_m)] > 0).all():
            raise ValueError(f"{self.name}: a depth without a standard deviation above 0")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """The pixels of a view as points of the world; NaN where nothing was measured.

    Attributes:
        point_m, toward: places, and unit vectors from them to the camera.
        normal: of the surface, towards the camera; where no plane fits, `toward` stands for it.
        plane: whether one fits.
        sigma_m: standard deviation along the ray.
        spacing_m: how far apart the rays of neighbouring pixels are there.
    """

    point_m: Float[np.ndarray, "h w 3"]
    toward: Float[np.ndarray, "h w 3"]
    normal: Float[np.ndarray, "h w 3"]
    plane: Bool[np.ndarray, "h w"]
    sigma_m: Float[np.ndarray, "h w"]
    spacing_m: Float[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False

    @property
    def known(self) -> Bool[np.ndarray, "h w"]:
        return np.isfinite(self.point_m[..., 2])


def points_of(view: MeasuredView) -> Points:
    """Each pixel's place on its true ray, with the normal of the plane through its neighbours."""
    camera, T = view.camera, view.T_world_cam
    ray = picture_rays(camera)
    length = np.linalg.norm(ray, axis=-1)
    depth_m = view.depth_m.astype(np.float64)
    toward = -(ray / length[..., None]) @ T[:3, :3].T
    normal_cam, _ = planes_of(view.depth_m, camera)
    plane = np.isfinite(normal_cam[..., 2])
    normal = np.where(plane[..., None], normal_cam @ T[:3, :3].T, toward)
    return Points(
        point_m=transform_points(T, ray * depth_m[..., None]),
        toward=toward,
        normal=normal,
        plane=plane,
        sigma_m=view.sigma_m * length,
        spacing_m=depth_m / math.sqrt(camera.fx_px * camera.fy_px),
    )


def planes_of(
    depth_m: Float[np.ndarray, "h w"], camera: Optics
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Normals in the camera's frame, and z of the plane through each pixel's neighbours [m].

    NaN where too few neighbours lie on one plane with the pixel.
    """
    known = np.isfinite(depth_m)
    normal, smooth = np.full((*known.shape, 3), np.nan), np.full(known.shape, np.nan)
    if not known.any():
        return normal, smooth
    f_px = math.sqrt(camera.fx_px * camera.fy_px)
    window_m = _WINDOW_PX * float(np.median(depth_m[known])) / f_px
    cut = crop(depth_m, camera, known, tight=True, reach_m=0.0, window_m=window_m)
    assert cut is not None  # some pixel is known
    h, w = cut.z.shape
    box = np.s_[cut.top_px : cut.top_px + h, cut.left_px : cut.left_px + w]
    normal[box], smooth[box] = cut.normal, cut.smooth
    return normal, smooth
