"""The measurement of one view in the form that fusion needs: points, normals and noise."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ...base.frames import transform_points
from ...camera.crop import crop
from ...rig.optics import Optics, picture_rays

_WINDOW_PX = 2  # half width of the windows in which planes are fitted
LEAST_COSINE = 0.2  # On steeper surfaces, the error of the normal exceeds the noise.
LEAST_SURENESS = 1e-6  # A point with p_wrong 1 has this weight, because a weight of 0 has no mean.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredView:
    """Depth map of one picture, with the camera and its pose.

    Attributes:
        name: name of the view in tables.
        depth_m: z in the camera frame; NaN without a measurement.
        sigma_m: standard deviation of z; NaN without a measurement.
        reason: number of the reason for missing depth, as in datasets; 0 for pixels with depth.
        color: colour picture in 8-bit sRGB.
        p_wrong: probability that a depth is wrong; NaN without a measurement, and None if it was
            not estimated.
    """

    name: str
    camera: Optics
    T_world_cam: Float[np.ndarray, "4 4"]
    depth_m: Float[np.ndarray, "h w"]
    sigma_m: Float[np.ndarray, "h w"]
    reason: UInt8[np.ndarray, "h w"]
    color: UInt8[np.ndarray, "h w 3"]
    p_wrong: Float[np.ndarray, "h w"] | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height_px, self.camera.width_px)
        for name in ("depth_m", "sigma_m", "reason", "color", "p_wrong"):
            array = getattr(self, name)
            if array is None:
                continue
            if array.shape[:2] != size:
                raise ValueError(f"{self.name}: {name} is {array.shape}, its camera has {size}")
            array.flags.writeable = False
        if not (self.sigma_m[np.isfinite(self.depth_m)] > 0).all():
            raise ValueError(f"{self.name}: a depth without a standard deviation above 0")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """Points in the world frame for all pixels of a view (as a map), or for a list of pixels.

    The points of pixels without a measurement are NaN.

    Attributes:
        pixel: row and column of each point.
        point_m, toward: positions, and unit vectors from the points to the camera.
        normal: surface normal towards the camera; equal to `toward` if no plane fits.
        plane: whether a plane fits the neighbouring pixels.
        sigma_m: standard deviation along the ray.
        sureness: probability that the depth is not wrong; 1 if it was not estimated.
        spacing_m: distance between the rays of neighbouring pixels, at the point.
    """

    pixel: Int[np.ndarray, "*n 2"]
    point_m: Float[np.ndarray, "*n 3"]
    toward: Float[np.ndarray, "*n 3"]
    normal: Float[np.ndarray, "*n 3"]
    plane: Bool[np.ndarray, "*n"]
    sigma_m: Float[np.ndarray, "*n"]
    sureness: Float[np.ndarray, "*n"]
    spacing_m: Float[np.ndarray, "*n"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False

    @property
    def known(self) -> Bool[np.ndarray, "*n"]:
        return np.isfinite(self.point_m[..., 2])

    @property
    def cosine(self) -> Float[np.ndarray, "*n"]:
        return (self.toward * self.normal).sum(axis=-1).clip(LEAST_COSINE, 1.0)

    @property
    def area_m2(self) -> Float[np.ndarray, "*n"]:
        """Area of the surface that each pixel covers."""
        return np.square(self.spacing_m) / self.cosine

    def variance_along(self, direction: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Return each point's variance along a direction [m^2], from its noise along the ray."""
        cosine = np.abs((self.toward * direction).sum(axis=-1)).clip(LEAST_COSINE, 1.0)
        return np.square(self.sigma_m * cosine)

    def at(self, pixel: Int[np.ndarray, "n 2"]) -> "Points":
        """Return the points of the given pixels, from a map of a whole picture."""
        index = tuple(pixel.T)
        names = [name for name in self.__dataclass_fields__ if name != "pixel"]
        return Points(pixel=pixel, **{name: getattr(self, name)[index] for name in names})


def points_of(view: MeasuredView) -> Points:
    """Return each pixel's point on its undistorted ray, with the normal of the plane around it."""
    camera, T = view.camera, view.T_world_cam
    ray = picture_rays(camera)
    length = np.linalg.norm(ray, axis=-1)
    depth_m = view.depth_m.astype(np.float64)
    toward = -(ray / length[..., None]) @ T[:3, :3].T
    normal_cam, _ = planes_of(view.depth_m, camera)
    plane = np.isfinite(normal_cam[..., 2])
    normal = np.where(plane[..., None], normal_cam @ T[:3, :3].T, toward)
    return Points(
        pixel=np.moveaxis(np.indices(plane.shape), 0, -1),
        point_m=transform_points(T, ray * depth_m[..., None]),
        toward=toward,
        normal=normal,
        plane=plane,
        sigma_m=view.sigma_m * length,
        sureness=_sureness(view),
        spacing_m=depth_m / math.sqrt(camera.fx_px * camera.fy_px),
    )


def _sureness(view: MeasuredView) -> Float[np.ndarray, "h w"]:
    """Return the probability that each depth is right; a wrong depth keeps a negligible weight."""
    if view.p_wrong is None:
        return np.where(np.isfinite(view.depth_m), 1.0, np.nan)
    return (1 - view.p_wrong.astype(np.float64)).clip(min=LEAST_SURENESS)


def planes_of(
    depth_m: Float[np.ndarray, "h w"], camera: Optics
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Return normals in the camera frame, and z [m] of the plane through each pixel's neighbours.

    Both are NaN if too few neighbours are on one plane with the pixel.
    """
    known = np.isfinite(depth_m)
    normal, smooth = np.full((*known.shape, 3), np.nan), np.full(known.shape, np.nan)
    if not known.any():
        return normal, smooth
    f_px = math.sqrt(camera.fx_px * camera.fy_px)
    window_m = _WINDOW_PX * float(np.median(depth_m[known])) / f_px
    cut = crop(depth_m, camera, known, tight=True, reach_m=0.0, window_m=window_m)
    assert cut is not None  # At least one pixel has a depth.
    h, w = cut.z.shape
    box = np.s_[cut.top_px : cut.top_px + h, cut.left_px : cut.left_px + w]
    normal[box], smooth[box] = cut.normal, cut.smooth
    return normal, smooth
