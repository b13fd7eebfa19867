"""Faults of a device's depth that its measuring principle does not explain, for simulated scans.

A scanner that outputs a smaller or rectified map selects one of several measured points for
each pixel. The point is right, but on a steep surface its depth differs from the depth at the
centre of the pixel. If the scanner instead takes the mean of the points in a window, weighted by
the light of each, the mean lies on the brighter side of the window. Windows of neighbouring pixels
overlap, so their places are related: places along x are alike in neighbouring rows, and change
their sign within a row, as the gradient of a random field does. Five real scans of a Photoneo PhoXi
show this on slopes of both directions (docs/twin.md). Such a scanner also lacks pixels beside depth
steps, where it removed the selected point.

The positions are fixed, because they belong to the raster and not to a shot.

A real picture has its device's faults already, so `scanner.measure`, which measures simulated
pictures, is the only function that adds them.

Leaves out: lines of a projector that lies above or below the camera, which are rows; that light
changes from shot to shot, as speckle does. In the real scans, half of this noise or more is another
one in every scan.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field
from scipy import ndimage

from ..base.settings import check_fields
from ..rig.optics import Optics
from .decode import DepthMap, Reason, depth_steps
from .finish import PATCH_M, uneven

# as a share of its depth, that a surface may rise from one pixel to the next but one
STEEPEST = 0.02
_SEED = 15  # of the raster; any number would do
_FINE = 2  # spots of light within a pixel, along either axis


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSpec:
    """The faults of a device; None or 0 switches a fault off, and all are off by default.

    `edge_x_px`, `edge_y_px`: see `_beside_steps`; the others: see `on_raster`.
    """

    edge_x_px: Annotated[
        float | None,
        Field(
            ge=0,
            le=1,
            description="The share of the pixels beside a depth step that have no depth, for steps "
            "between two neighbours in a row. A pixel has none if its measured point is nearer to "
            "the step than this number of pixels.",
        ),
    ] = None
    edge_y_px: Annotated[
        float | None,
        Field(
            ge=0,
            le=1,
            description="The share of the pixels beside a depth step that have no depth, for steps "
            "between two neighbours in a column. A pixel has none if its measured point is nearer "
            "to the step than this number of pixels.",
        ),
    ] = None
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
    raster_window_px: Annotated[
        float | None,
        Field(
            ge=0.4,
            le=4,
            description="The measured point of a pixel is the mean of the points in a window "
            "around it, weighted by their light. This is the standard deviation of the window in "
            "pixels. Without it, the measured points of neighbouring pixels are independent.",
        ),
    ] = None
    raster_window_share: Annotated[
        float,
        Field(
            ge=0,
            le=1,
            description="The share of the variance of raster_px that the light in the window "
            "causes. The rest is independent from pixel to pixel.",
        ),
    ] = 1.0
    raster_limit_m: Annotated[
        float | None,
        Field(
            gt=0,
            description="The largest standard deviation of depth, in metres, that raster_px adds, "
            "however steep a surface is.",
        ),
    ] = None
    raster_unevenness: Annotated[
        float | None,
        Field(
            ge=0,
            le=1,
            description="The value of raster_px differs between patches of a surface. This is the "
            "standard deviation of its natural logarithm.",
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
    camera: Optics,
    *,
    step_angle_deg: float,
    light_contrast: Float[np.ndarray, "h w"] | float = 1.0,
) -> DepthMap:
    """The depth that a device with these faults gives for a filtered depth map.

    Args:
        depth: z and its standard deviation [m].
        camera: whose pixels these are.
        step_angle_deg: neighbours belong to two surfaces above this angle of incidence.
        light_contrast: how uneven the light in each pixel is, as a share of a black surface's; it
            scales the places of `raster_px`.

    Returns:
        A depth map in which the pixels that are lost beside steps are NaN with `Reason.OUTLIER`,
        and `sigma_m` holds what `raster_px` adds; the same map where no fault is on.
    """
    if spec.edge_x_px or spec.edge_y_px:
        edge_px = spec.edge_x_px or 0.0, spec.edge_y_px or 0.0
        lost = _beside_steps(depth_steps(depth, camera, angle_deg=step_angle_deg), edge_px)
        nothing = np.float32(np.nan)
        depth = DepthMap(
            depth_m=np.where(lost, nothing, depth.depth_m),
            sigma_m=np.where(lost, nothing, depth.sigma_m),
            reason=np.where(lost, np.uint8(Reason.OUTLIER), depth.reason),
        )
    if spec.raster_px:
        depth = on_raster(
            depth,
            spec.raster_px,
            window_px=spec.raster_window_px or 0.0,
            window_share=spec.raster_window_share,
            light_contrast=light_contrast,
            limit_m=spec.raster_limit_m or math.inf,
            unevenness=spec.raster_unevenness or 0.0,
            line_unevenness=spec.raster_line_unevenness or 0.0,
            focal_px=camera.fx_px,
        )
    return depth


def _beside_steps(
    step: Bool[np.ndarray, "2 h w"], edge_px: tuple[float, float]
) -> Bool[np.ndarray, "h w"]:
    """Points beside steps along rows and along columns, on either side.

    A step lies half way between two pixels, and the measured point of a pixel lies anywhere in its
    square, as on a raster without a window. A device that measures more points than its map shows
    loses a point whose own neighbour, which the map does not show, lies across the step.
    """
    aside_px = places(step.shape[1:], 0.0) / (2 * math.sqrt(3))  # evenly from -1/2 to 1/2
    lost = np.zeros(step.shape[1:], dtype=np.bool_)
    for axis, toward in ((0, 1), (1, 0)):  # of `step`: rightwards, downwards
        to_next = 0.5 - aside_px[axis] < edge_px[axis]
        to_last = 0.5 + aside_px[axis] < edge_px[axis]
        here, after = step[axis], np.roll(step[axis], 1, toward)
        lost |= here & to_next | after & to_last
    return lost


def on_raster(
    depth: DepthMap,
    raster_px: float,
    *,
    window_px: float = 0.0,
    window_share: float = 1.0,
    limit_m: float = math.inf,
    unevenness: float = 0.0,
    line_unevenness: float = 0.0,
    light_contrast: Float[np.ndarray, "h w"] | float = 1.0,
    focal_px: float,
) -> DepthMap:
    """The depth at a point `raster_px` (one sigma along each axis) from the pixel's centre.

    `window_px` and `window_share` are those of `places`. `light_contrast` is how uneven the light
    in a pixel's window is, as a share of that on a black surface: where a surface has an even
    light, as white paper has, the mean of the window's points lies nearer to the centre by it.

    With a `limit_m`, the error of depth on a surface that rises by s per pixel is not
    `raster_px s`, but `1 / sqrt(1 / (raster_px s)^2 + 1 / limit_m^2)`. So it is unchanged on gentle
    slopes and ends at `limit_m` on the steepest, as in a scanner that leaves points out of its
    window whose depth is too different.

    With an `unevenness` above 0 the points of some patches are farther from their centres, and
    those of others nearer (`finish.uneven`); the mean square stays the same.

    With a `line_unevenness` above 0 they differ from pixel to pixel, too, but hardly between the
    pixels of a column that touch (`line_amplitude`).

    The surface is the plane, in inverse depth, through both neighbours of a pixel along each axis;
    beside steps and holes it is flat. `sigma_m` holds what the place does to the depth.
    """
    shape = depth.depth_m.shape
    away_px = np.full(shape, raster_px)
    if unevenness and np.isfinite(depth.depth_m).any():
        patch_px = focal_px * PATCH_M / float(np.nanmedian(depth.depth_m))
        away_px = uneven(away_px, unevenness, patch_px=patch_px, seed=_SEED)
    if line_unevenness:
        away_px = away_px * line_amplitude(shape, line_unevenness)
    right, down = places(shape, window_px, window_share) * away_px
    inverse = 1 / depth.depth_m.astype(np.float64)
    along, across = _slope(inverse, 1), _slope(inverse, 0)
    spread_m = raster_px * np.hypot(along, across) / inverse**2
    left = light_contrast / np.hypot(1, spread_m / limit_m)
    depth_m = 1 / (inverse + left * (right * along + down * across))
    return replace(
        depth,
        depth_m=depth_m.astype(np.float32),
        sigma_m=np.hypot(depth.sigma_m, left * spread_m).astype(np.float32),
    )


def places(
    shape: tuple[int, int], window_px: float, window_share: float = 1.0
) -> Float[np.ndarray, "2 h w"]:
    """Where each pixel's point lies, to the right and downwards, with a variance of one.

    Without a window, places are independent and even over a square. With one of the standard
    deviation w, a place is the mean of `r` weighted by `exp(-r^2 / 2 w^2)` and by light that is
    independent from spot to spot. To first order in the light's contrast this is the gradient of
    a Gaussian convolved with white noise. Two pixels at a distance r have the correlation
    `exp(-r^2 / 4 w^2)` across the direction of the place, and along it `1 - r^2 / 2 w^2` times as
    much. Of the variance, `window_share` is the window's, and the rest is independent: a scanner
    that takes the mean of few points has both.
    """
    rng = np.random.default_rng(_SEED)
    alone = np.sqrt(3) * rng.uniform(-1, 1, (2, *shape))
    if not window_px:
        return alone
    light = rng.standard_normal((_FINE * shape[0], _FINE * shape[1]), dtype=np.float32)
    sigma = _FINE * window_px
    middle = np.zeros(2 * int(8 * sigma) + 3)
    middle[len(middle) // 2] = 1.0
    norm = np.sqrt(np.prod([(ndimage.gaussian_filter1d(middle, sigma, order=order) ** 2).sum()
                            for order in (0, 1)]))  # fmt: skip
    right, down = (
        ndimage.gaussian_filter(light, sigma, order=order, mode="wrap")[::_FINE, ::_FINE] / norm
        for order in ((0, 1), (1, 0))
    )
    shared = np.stack([right, down])
    return np.sqrt(window_share) * shared + np.sqrt(1 - window_share) * alone


def line_amplitude(shape: tuple[int, int], unevenness: float) -> Float[np.ndarray, "h w"]:
    """A factor of each pixel's place, by a log-normal law whose mean square is 1.

    Its logarithm has the standard deviation `unevenness`. It is independent between columns; along
    a column, two pixels at a distance r have the correlation `exp(-r^2 / 4)`. In five real scans,
    the sizes of errors are alike in this way: what makes them lies along the projector's lines.
    """
    rng = np.random.default_rng(_SEED + 1)
    middle = np.zeros(2 * 8 + 1)
    middle[len(middle) // 2] = 1.0
    norm = np.sqrt((ndimage.gaussian_filter1d(middle, 1.0) ** 2).sum())
    field = ndimage.gaussian_filter1d(rng.standard_normal(shape), 1.0, axis=0, mode="wrap") / norm
    return np.exp(unevenness * field - unevenness**2)


def _slope(inverse: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Change of inverse depth per pixel; 0 where a neighbour is missing or another surface."""
    slope = np.zeros(inverse.shape)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    rise = (np.roll(inverse, -1, axis) - np.roll(inverse, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        same = np.abs(rise) < STEEPEST * inverse[inner]  # NaN is not <
    slope[inner] = np.where(same, 0.5 * rise, 0.0)
    return slope
