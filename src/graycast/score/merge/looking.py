"""What one view has to say of points that another measured."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ...base.frames import inverse, transform_points
from ...rig.optics import project
from .view import LEAST_COSINE, MeasuredView, Points

SIGMAS = 4.0  # Views of one surface may differ by so many standard deviations.
_TURNED = 0.5  # Normals of one surface have a larger cosine: beyond 60 degrees it is another.
_ASIDE = 1.0  # Another view's point may stand for this one up to so many pixels along the surface.
# Per metre aside, a surface may leave its plane by the first; without a plane, the second counts.
_SLOPE, _UNKNOWN_SLOPE = 0.2, 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Pixels of a view in a row, with the fields of `Points`; NaN where nothing was measured."""

    pixel: Int[np.ndarray, "n 2"]  # row and column
    point_m: Float[np.ndarray, "n 3"]
    toward: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    plane: Bool[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]
    spacing_m: Float[np.ndarray, " n"]

    def variance_along(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Of each point along a direction [m^2]: noise is along the ray, and its shadow counts."""
        cosine = np.abs((self.toward * direction).sum(axis=-1)).clip(LEAST_COSINE, 1.0)
        return np.square(self.sigma_m * cosine)

    @property
    def cosine(self) -> Float[np.ndarray, " n"]:
        return (self.toward * self.normal).sum(axis=-1).clip(LEAST_COSINE, 1.0)

    @property
    def area_m2(self) -> Float[np.ndarray, " n"]:
        """Of the surface, what a pixel covers."""
        return np.square(self.spacing_m) / self.cosine


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewAgreement:
    """A view's answer for each point: it agrees, sees through it, is hidden from it, or is silent.

    Attributes:
        inside: the point is in the view's picture, at `pixel`.
        there: what the view measured at that pixel.
        agrees: it is the point's own surface.
        through: it is behind the point, on all sides.
        before: it is before the point.
        offset_m: from the point to the view's surface, along the mean of both normals.
        variance_m2: of what the view measured, along that mean.
    """

    inside: Bool[np.ndarray, " n"]
    there: Measured
    agrees: Bool[np.ndarray, " n"]
    through: Bool[np.ndarray, " n"]
    before: Bool[np.ndarray, " n"]
    offset_m: Float[np.ndarray, " n"]
    variance_m2: Float[np.ndarray, " n"]


def at(points: Points, pixel: Int[np.ndarray, "n 2"]) -> Measured:
    """What a view has at some of its pixels."""
    row, column = pixel.T
    values = {name: getattr(points, name)[row, column] for name in Points.__dataclass_fields__}
    return Measured(pixel=pixel, **values)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectedPoints:
    """The pixel of a view at which each point would be seen, named as in `ViewAgreement`.

    `depth_m` is the point's own z in the view's camera.
    """

    inside: Bool[np.ndarray, " n"]
    there: Measured
    agrees: Bool[np.ndarray, " n"]
    offset_m: Float[np.ndarray, " n"]
    variance_m2: Float[np.ndarray, " n"]
    depth_m: Float[np.ndarray, " n"]


def meet(own: Measured, view: MeasuredView, points: Points) -> ProjectedPoints:
    """What a view measured where it would see another's points."""
    camera = view.camera
    place = transform_points(inverse(view.T_world_cam), own.point_m)
    column, row = np.rint(np.nan_to_num(project(camera, place), nan=-1.0)).T
    inside = (column >= 0) & (column < camera.width_px) & (row >= 0) & (row < camera.height_px)
    pixel = np.where(inside[:, None], np.stack([row, column], axis=-1), 0).astype(np.int64)
    there = at(points, pixel)
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


def look(own: Measured, view: MeasuredView, points: Points) -> ViewAgreement:
    """Ask a view about another's points.

    A view sees through a point where all nine pixels about the place have measured something
    behind it, and the middle one a plane that the point lies before.
    """
    met = meet(own, view, points)
    inside, there, agrees = met.inside, met.there, met.agrees
    behind_m = _nearest_m(view.depth_m)[tuple(there.pixel.T)] - met.depth_m
    beyond = behind_m > SIGMAS * np.hypot(own.sigma_m, there.sigma_m)
    through = inside & there.plane & ~agrees & beyond & _over_plane(own, there)
    apart = there.point_m - own.point_m
    before = inside & ~agrees & ((apart * there.toward).sum(axis=-1) > 0)
    return ViewAgreement(
        inside=inside,
        there=there,
        agrees=agrees,
        through=through,
        before=before,
        offset_m=met.offset_m,
        variance_m2=met.variance_m2,
    )


def _mean_normal(own: Measured, there: Measured) -> Float[np.ndarray, "n 3"]:
    """Across the surface between two points of it; on a sphere the way between is square to it.

    Where one has no plane, the other's normal.
    """
    total = np.where((own.plane | ~there.plane)[:, None], own.normal, 0.0)
    total = total + np.where(there.plane[:, None], there.normal, 0.0)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    # Opposite normals, which are of no one surface, have no mean.
    return np.where(length > LEAST_COSINE, total / np.maximum(length, LEAST_COSINE), own.normal)


def _on_one_surface(
    own: Measured,
    there: Measured,
    across: Float[np.ndarray, "n 3"],
    offset_m: Float[np.ndarray, " n"],
    aside_m: Float[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """False where either is unknown."""
    spread_m = np.sqrt(own.variance_along(across) + there.variance_along(across))
    both = own.plane & there.plane
    slope = np.where(both, _SLOPE, _UNKNOWN_SLOPE)
    # Without a plane the way to the camera stands for the normal: it is on the same side.
    turned = (own.normal * there.normal).sum(axis=-1) < np.where(both, _TURNED, 0.0)
    reach_m = _ASIDE * there.spacing_m / there.cosine + SIGMAS * (own.sigma_m + there.sigma_m)
    near = (np.abs(offset_m) <= SIGMAS * spread_m + slope * aside_m) & (aside_m <= reach_m)
    return near & ~turned


def _over_plane(own: Measured, there: Measured) -> Bool[np.ndarray, " n"]:
    """Whether the point lies before the other's plane, by more than both noises."""
    apart = own.point_m - there.point_m
    height_m = (apart * there.normal).sum(axis=-1)
    aside_m = np.linalg.norm(apart - height_m[:, None] * there.normal, axis=-1)
    spread_m = np.sqrt(own.variance_along(there.normal) + there.variance_along(there.normal))
    # Aside lies mostly the way along the ray between both, on which no surface can bend.
    return height_m > SIGMAS * spread_m + _SLOPE * np.minimum(aside_m, there.spacing_m)


def _nearest_m(depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """The least depth of the nine pixels about each; 0 where one of them has none."""
    return ndimage.minimum_filter(np.nan_to_num(depth_m, nan=0.0), 3, mode="constant", cval=0.0)
