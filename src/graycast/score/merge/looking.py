"""Comparison of one view with points that another view measured."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...base.frames import inverse, transform_points
from ...rig.optics import pixels_of
from .view import LEAST_COSINE, MeasuredView, Points

SIGMAS = 4.0  # largest difference of two views of one surface, in standard deviations
_TURNED = 0.5  # Normals that differ by more than 60 degrees (this cosine) are of two surfaces.
_ASIDE = 1.0  # largest lateral distance in pixels at which points of two views are the same place
# largest deviation from the plane per metre of lateral distance; the second is for pixels that have
# no plane.
_SLOPE, _UNKNOWN_SLOPE = 0.2, 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectedPoints:
    """Points of another view, projected into a view and compared with its measurement.

    Attributes:
        inside: whether the point is in the view's picture.
        there: point that the view measured at that pixel.
        agrees: whether both points are on the same surface.
        offset_m: distance from the point to the view's surface, along the mean of both normals.
        variance_m2: variance of the view's point along this mean normal.
        depth_m: z of the projected point in the view's camera.
    """

    inside: Bool[np.ndarray, " n"]
    there: Points
    agrees: Bool[np.ndarray, " n"]
    offset_m: Float[np.ndarray, " n"]
    variance_m2: Float[np.ndarray, " n"]
    depth_m: Float[np.ndarray, " n"]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewAgreement:
    """Relation of a view to each point: agreement, sight through it, occlusion, or no measurement.

    Attributes:
        met: the points as projected into the view, with their agreement.
        through: whether all that the view measured around the point is behind the point.
        before: whether the view's surface is in front of the point.
    """

    met: ProjectedPoints
    through: Bool[np.ndarray, " n"]
    before: Bool[np.ndarray, " n"]


def meet(own: Points, view: MeasuredView, points: Points) -> ProjectedPoints:
    """Return what a view measured at the pixels onto which another view's points project."""
    place = transform_points(inverse(view.T_world_cam), own.point_m)
    pixel, inside = pixels_of(view.camera, place)
    there = points.at(pixel)
    apart = there.point_m - own.point_m
    across = _mean_normal(own, there)
    offset_m = (apart * across).sum(axis=-1)
    aside_m = np.linalg.norm(apart - offset_m[:, None] * across, axis=-1)
    return ProjectedPoints(
        inside=inside,
        there=there,
        agrees=inside & _on_one_surface(own, there, across, offset_m, aside_m),
        offset_m=offset_m,
        variance_m2=there.variance_along(across),
        depth_m=place[:, 2],
    )


def look(own: Points, view: MeasuredView, points: Points) -> ViewAgreement:
    """Return the relation of a view to another view's points.

    A view sees through a point if all nine pixels around the point's projection measured a surface
    behind it, and the central pixel measured a plane behind it.
    """
    met = meet(own, view, points)
    there, other = met.there, met.inside & ~met.agrees
    behind_m = _nearest_m(view.depth_m)[tuple(there.pixel.T)] - met.depth_m
    beyond = behind_m > SIGMAS * np.hypot(own.sigma_m, there.sigma_m)
    apart = there.point_m - own.point_m
    return ViewAgreement(
        met=met,
        through=other & there.plane & beyond & _over_plane(own, there),
        before=other & ((apart * there.toward).sum(axis=-1) > 0),
    )


def _mean_normal(own: Points, there: Points) -> Float[np.ndarray, "n 3"]:
    """Return the mean of both normals; on planes and spheres, it is normal to their chord.

    If only one of the points has a plane, return its normal.
    """
    total = np.where((own.plane | ~there.plane)[:, None], own.normal, 0.0)
    total = total + np.where(there.plane[:, None], there.normal, 0.0)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    # Opposite normals belong to different surfaces and have no mean.
    return np.where(length > LEAST_COSINE, total / np.maximum(length, LEAST_COSINE), own.normal)


def _on_one_surface(
    own: Points,
    there: Points,
    across: Float[np.ndarray, "n 3"],
    offset_m: Float[np.ndarray, " n"],
    aside_m: Float[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """Return whether both points are on the same surface; False if a point is unknown."""
    spread_m = np.sqrt(own.variance_along(across) + there.variance_along(across))
    both = own.plane & there.plane
    slope = np.where(both, _SLOPE, _UNKNOWN_SLOPE)
    # Without a plane, the direction to the camera replaces the normal, on the same side.
    turned = (own.normal * there.normal).sum(axis=-1) < np.where(both, _TURNED, 0.0)
    reach_m = _ASIDE * there.spacing_m / there.cosine + SIGMAS * (own.sigma_m + there.sigma_m)
    near = (np.abs(offset_m) <= SIGMAS * spread_m + slope * aside_m) & (aside_m <= reach_m)
    return near & ~turned


def _over_plane(own: Points, there: Points) -> Bool[np.ndarray, " n"]:
    """Return whether each point is in front of the plane `there` by more than the noise of both."""
    apart = own.point_m - there.point_m
    height_m = (apart * there.normal).sum(axis=-1)
    aside_m = np.linalg.norm(apart - height_m[:, None] * there.normal, axis=-1)
    spread_m = np.sqrt(own.variance_along(there.normal) + there.variance_along(there.normal))
    # Most of the lateral distance is along the ray between both, on which no surface can curve.
    return height_m > SIGMAS * spread_m + _SLOPE * np.minimum(aside_m, there.spacing_m)


def _nearest_m(depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Return the smallest depth of the 3 x 3 pixels around each pixel; 0 if one is missing."""
    return ndimage.minimum_filter(np.nan_to_num(depth_m, nan=0.0), 3, mode="constant", cval=0.0)
