"""Standard deviation of depth beyond the sensor's noise: what displaces decoded positions.

Speckle moves a pixel's light off its centre; uneven projector lines shift decoded positions.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..rig import Rig
from .maps import CodeMap, DepthMap
from .triangulation import triangulation_axis

STEP_RATIO = 4.0  # a position that rises this much faster than on a facing surface is a step


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
        seen = np.hypot(off_px * np.hypot(along, across), np.float32(place_px)) / sigma_px
        sigma_m = depth.sigma_m * np.sqrt(1 + seen * seen)
    return replace(depth, sigma_m=sigma_m.astype(np.float32))


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
