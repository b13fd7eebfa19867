"""Standard deviation of depth beyond the sensor's noise.

Speckle moves a pixel's light off its centre; uneven projector lines shift decoded positions; where
a surface bends, a pixel sees more than the depth at its centre.
"""

import math
from dataclasses import replace

import numba
import numpy as np
from jaxtyping import Float

from ...base.kernels import kernel
from ...rig.pair import Rig
from .maps import CodeMap, DepthMap
from .triangulation import triangulation_axis

BEND_SIGMAS = 2.0  # A bend of less than this many standard deviations may be noise.
# A pixel that a step divides at random is off by a root mean square of 0.29 of the step, of which
# the largest of the bends at it and beside it is 0.75; a fold through it is off by an eighth at
# most. This share is between the two. docs/measurements/materials.md has what it makes of sigma.
BEND_SHARE = 0.25
STEP_RATIO = 4.0  # A position that rises this much faster than on a facing surface is a step.


def with_place_sigma(codes: CodeMap, sigma_px: Float[np.ndarray, "2 h w"]) -> CodeMap:
    """The same positions, with an error of the pictures' light (column, row) added to sigma."""
    return replace(
        codes,
        sigma_column=np.hypot(codes.sigma_column, sigma_px[0]),
        sigma_row=np.hypot(codes.sigma_row, sigma_px[1]),
    )


def with_displacement(
    depth: DepthMap,
    codes: CodeMap,
    rig: Rig,
    off_px: Float[np.ndarray, "h w"],
    *,
    place_px: float = 0.0,
) -> DepthMap:
    """The same depth, with the displacement of light within a pixel added to sigma.

    A centre that lies `off_px` aside (one sigma along either axis) shows the position decoded
    there, `grad u . off`, and depth is wrong by `dz/du` times that. The gradient is seen between
    both neighbours; beside steps and holes it is that of a surface that faces the rig. `place_px`
    is an error of each decoded position itself (one sigma).
    """
    column = triangulation_axis(rig) == "column"
    u, sigma_px = (codes.column, codes.sigma_column) if column else (codes.row, codes.sigma_row)
    lens, other = rig.camera, rig.projector
    facing = other.fx_px / lens.fx_px if column else other.fy_px / lens.fy_px
    along = _gradient(u, 1, facing if column else 0.0, STEP_RATIO * facing)
    across = _gradient(u, 0, 0.0 if column else facing, STEP_RATIO * facing)
    with np.errstate(divide="ignore", invalid="ignore"):
        # In standard deviations of the code.
        across_px = np.hypot(off_px * np.hypot(along, across), np.float32(place_px)) / sigma_px
        sigma_m = depth.sigma_m * np.sqrt(1 + across_px * across_px)
    return replace(depth, sigma_m=sigma_m.astype(np.float32))


def with_bends(depth: DepthMap) -> DepthMap:
    """The same depth, with a share of the surface's bend at each pixel added to sigma.

    A pixel sees an area, and the depth at its centre differs from what it sees where a fold or a
    small step crosses it. The bend is the second difference of inverse depth along a row or column,
    which is 0 on a plane: the largest one of the pixel and its two neighbours, beyond noise.
    Beside a pixel without depth the bend is not known and adds nothing.
    """
    inverse = 1 / depth.depth_m
    noise2 = np.square(depth.sigma_m * np.square(inverse))
    bend2 = np.zeros((2, *inverse.shape), dtype=np.float32)
    _find_bends(inverse, noise2, BEND_SIGMAS**2, bend2)
    _widen(bend2, depth.depth_m, BEND_SHARE**2, sigma_m := depth.sigma_m.copy())
    return replace(depth, sigma_m=sigma_m)


@kernel(parallel=True)
def _find_bends(inverse, noise2, sigmas2, bend2):
    """Square of the bend along the row and the column at each pixel, less that of noise."""
    h, w = inverse.shape
    for y in numba.prange(h):
        for axis, down, right in ((0, 0, 1), (1, 1, 0)):
            if down <= y < h - down:
                for x in range(right, w - right):
                    before, after = (y - down, x - right), (y + down, x + right)
                    bend = inverse[before] + inverse[after] - 2 * inverse[y, x]
                    noise = noise2[before] + noise2[after] + 4 * noise2[y, x]
                    beyond = bend * bend - sigmas2 * noise
                    bend2[axis, y, x] = beyond if beyond > 0 else 0  # 0 for NaN


@kernel(parallel=True)
def _widen(bend2, depth, share2, sigma):
    h, w = depth.shape
    for y in numba.prange(h):
        above, below = max(y - 1, 0), min(y + 1, h - 1)
        for x in range(w):
            left, right = max(x - 1, 0), min(x + 1, w - 1)
            largest2 = max(bend2[0, y, left], bend2[0, y, x], bend2[0, y, right])
            largest2 = max(largest2, bend2[1, above, x], bend2[1, y, x], bend2[1, below, x])
            if largest2 > 0:
                depth2 = depth[y, x] * depth[y, x]
                sigma[y, x] = math.sqrt(sigma[y, x] ** 2 + share2 * largest2 * depth2 * depth2)


def _gradient(
    u: Float[np.ndarray, "h w"], axis: int, facing: float, most: float
) -> Float[np.ndarray, "h w"]:
    """Of a position per pixel along one axis; `facing` where neighbours do not tell."""
    slope = np.full(u.shape, facing, dtype=np.float32)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    middle = 0.5 * (np.roll(u, -1, axis) - np.roll(u, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        slope[inner] = np.where(np.abs(middle) <= most, middle, slope[inner])  # NaN is not <=
    return slope
