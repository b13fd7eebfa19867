"""Simulate a depth error of real devices that their measuring principle does not explain.

A scanner that outputs a smaller or rectified map selects one of several measured points for each
pixel. The point is right, but on a sloping surface its depth differs from the depth at the centre
of the pixel. On a steep surface such a scanner leaves out points whose depth differs too much, so
the error has a limit, as in five real scans of a PhoXi (docs/measurements/twin.md).

The positions of the points are fixed: they belong to the device's raster and not to a scan.

Pictures of a real device already contain this error, so only `scanner.measure`, which measures
simulated pictures, adds it.

Leaves out: the rows of a projector above or below the camera (only columns have their own error);
neighbouring pixels that share points, as in means over overlapping windows; errors that change
from scan to scan, as speckle does. In the five scans, about half of this noise changes from scan
to scan.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field
from scipy import ndimage

from ..base.public_value import public_value
from ..base.settings import check_fields
from .decode import DepthMap
from .sigma import with_depth_term

STEEPEST = 0.02  # A change of depth over two pixels by more than this share is a step.
_SEED = 15  # An arbitrary number that makes these draws independent of all other draws of a seed.
_SMOOTHED = (4 * math.pi) ** -0.25  # Standard deviation of white noise after a Gaussian of 1 px.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSpec:
    """The faults of a device; None or 0 switches a fault off, and all are off by default."""

    raster_px: Annotated[
        float | None,
        Field(
            ge=0,
            le=1,
            description="The depth of a pixel is measured at a point beside the pixel's centre. "
            "This is the standard deviation of the distance between both along each axis, in "
            "pixels.",
        ),
    ] = None
    raster_limit_m: Annotated[
        float | None,
        Field(
            gt=0,
            description="The largest standard deviation of depth, in metres, that raster_px adds, "
            "however steep a surface is.",
        ),
    ] = None
    raster_line_unevenness: Annotated[
        float | None,
        Field(
            ge=0,
            le=1,
            description="The value of raster_px differs from column to column and hardly between "
            "adjacent pixels of one column. This is the standard deviation of its natural "
            "logarithm.",
        ),
    ] = None

    def __post_init__(self) -> None:
        check_fields(self)


def with_faults(
    depth: DepthMap,
    spec: FaultSpec,
    *,
    seed: int,
    light_contrast: Float[np.ndarray, "h w"] | float = 1.0,
) -> DepthMap:
    """Return the depth that a device with these faults outputs for a filtered depth map.

    This is the depth at a point that is `raster_px` (one standard deviation along each axis) from
    the pixel's centre. Between pixels, inverse depth is interpolated by a plane through a pixel's
    neighbours; next to steps and holes the slope is taken as 0.

    With a `raster_limit_m`, the error of depth on a surface that rises by s per pixel is not
    `raster_px s`, but `1 / sqrt(1 / (raster_px s)^2 + 1 / raster_limit_m^2)`: it is unchanged on
    gentle slopes and tends to the limit on steep ones.

    Args:
        depth: z and its standard deviation [m].
        seed: seed of the device's raster.
        light_contrast: unevenness of the light within each pixel, relative to a black surface.
            Where the light is more even, as on white paper, the point is nearer to the centre.

    Returns:
        A depth map whose `sigma_m` includes the error; the unchanged map if `raster_px` is off.
    """
    if not spec.raster_px:
        return depth
    shape, limit_m = depth.depth_m.shape, spec.raster_limit_m or math.inf
    amplitude = line_amplitude(shape, spec.raster_line_unevenness or 0.0, seed=seed)
    right, down = spec.raster_px * amplitude * places(shape, seed=seed)
    inverse = 1 / depth.depth_m.astype(np.float64)
    along, across = _slope(inverse, 1), _slope(inverse, 0)
    spread_m = spec.raster_px * np.hypot(along, across) / inverse**2
    left = light_contrast / np.hypot(1, spread_m / limit_m)
    depth_m = 1 / (inverse + left * (right * along + down * across))
    measured = replace(depth, depth_m=depth_m.astype(np.float32))
    return with_depth_term(measured, left * spread_m)


def places(shape: tuple[int, ...], *, seed: int) -> Float[np.ndarray, "2 h w"]:
    """Return the offset of each pixel's point to the right and downwards, with a variance of 1.

    The offsets are independent and uniformly distributed.
    """
    return np.sqrt(3) * np.random.default_rng([_SEED, seed]).uniform(-1, 1, (2, *shape))


def line_amplitude(
    shape: tuple[int, ...], unevenness: float, *, seed: int
) -> Float[np.ndarray, "h w"]:
    """Return a log-normal factor, with a mean square of 1, for the offset of each pixel's point.

    Its logarithm has the standard deviation `unevenness`. Columns are independent; two pixels of a
    column at a distance r have the correlation `exp(-r^2 / 4)`. In five real scans the sizes of
    errors correlate in this way, so their cause must follow the projector's lines.
    """
    field = np.random.default_rng([_SEED + 1, seed]).standard_normal(shape)
    field = ndimage.gaussian_filter1d(field, 1.0, axis=0, mode="wrap")
    return np.exp(unevenness * field / _SMOOTHED - unevenness**2)


def _slope(inverse: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Return the change of inverse depth per pixel; 0 next to a hole or another surface."""
    slope = np.zeros(inverse.shape)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    rise = (np.roll(inverse, -1, axis) - np.roll(inverse, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        same = np.abs(rise) < STEEPEST * inverse[inner]  # False for NaN
    slope[inner] = np.where(same, 0.5 * rise, 0.0)
    return slope
