"""A fault of a device's depth that its measuring principle does not explain, for simulated scans.

A scanner that outputs a smaller or rectified map selects one of several measured points for each
pixel. The point is right, but on a sloping surface its depth differs from the depth at the centre
of the pixel. On a steep surface such a scanner leaves out points whose depth is too different, so
the error ends at a limit: in five real scans of a PhoXi it does (docs/measurements/twin.md).

The positions are fixed, because they belong to the raster of a device and not to a shot.

A real picture has its device's faults already, so `scanner.measure`, which measures simulated
pictures, is the only function that adds them.

Leaves out: lines of a projector that lies above or below the camera, which are rows; places that
neighbouring pixels have in common, as the means over windows that overlap have; light that changes
from shot to shot, as speckle does. In the five scans, about half of this noise is another one in
every scan.
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

STEEPEST = 0.02  # A surface rises by less than this share of its depth over two pixels.
_SEED = 15  # Any number would do. A device with the seed 0 has the numbers of this seed alone.
_SMOOTHED = (4 * math.pi) ** -0.25  # A Gaussian of one pixel leaves this of white noise's sigma.


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
    """Return the depth that a device with these faults gives for a filtered depth map.

    It is that of a point `raster_px` (one sigma along each axis) from the pixel's centre, on the
    plane, in inverse depth, through both neighbours of a pixel along each axis; beside steps and
    holes that is flat.

    With a `raster_limit_m`, the error of depth on a surface that rises by s per pixel is not
    `raster_px s`, but `1 / sqrt(1 / (raster_px s)^2 + 1 / raster_limit_m^2)`. So it is unchanged on
    gentle slopes and ends at the limit on the steepest.

    Args:
        depth: z and its standard deviation [m].
        seed: of the device's raster.
        light_contrast: how uneven the light in each pixel is, as a share of that on a black
            surface: where a surface has an even light, as white paper has, the point lies nearer
            to the centre.

    Returns:
        A depth map whose `sigma_m` holds what `raster_px` adds; the same map where it is off.
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
    """Return where each pixel's point lies, to the right and downwards, with a variance of one.

    They are independent and even over a square.
    """
    return np.sqrt(3) * np.random.default_rng([_SEED, seed]).uniform(-1, 1, (2, *shape))


def line_amplitude(
    shape: tuple[int, ...], unevenness: float, *, seed: int
) -> Float[np.ndarray, "h w"]:
    """Return a factor of each pixel's place, by a log-normal law whose mean square is 1.

    Its logarithm has the standard deviation `unevenness`. It is independent between columns; along
    a column, two pixels at a distance r have the correlation `exp(-r^2 / 4)`. In five real scans,
    the sizes of errors are alike in this way: what makes them lies along the projector's lines.
    """
    field = np.random.default_rng([_SEED + 1, seed]).standard_normal(shape)
    field = ndimage.gaussian_filter1d(field, 1.0, axis=0, mode="wrap")
    return np.exp(unevenness * field / _SMOOTHED - unevenness**2)


def _slope(inverse: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Change of inverse depth per pixel; 0 where a neighbour is missing or another surface."""
    slope = np.zeros(inverse.shape)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    rise = (np.roll(inverse, -1, axis) - np.roll(inverse, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        same = np.abs(rise) < STEEPEST * inverse[inner]  # NaN is not <
    slope[inner] = np.where(same, 0.5 * rise, 0.0)
    return slope
