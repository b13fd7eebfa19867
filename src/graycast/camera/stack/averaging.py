"""All camera pixels that see one projector pixel, joined to one point."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.errors import DecodeError
from ...base.frames import transform_points
from ...rig.optics import rays
from ...rig.pair import Rig
from ...rig.pattern import AXES, Code
from ..decode import CodeMap, Reason
from ..decode.plan import plan_axes

# A pixel belongs to the next cell with some chance: below the first it surely sees its own; where
# no pixel of a cell is that sure, those below the second stand for it.
MAX_WRONG, MAX_WRONG_ALONE = 0.02, 0.2
# Pixels of a cell scatter about their mean by sqrt(n / 2 pi) where they fill a disc; a slanted
# surface makes that an ellipse. This many times as far, and half a pixel, is another surface's.
MAX_SCATTER, SCATTER_PX = 2.0, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Projector pixels that were seen: where in the camera, where on the projector.

    `sure_pixels` counts the camera pixels that the means are of; 0 where all were in doubt.
    """

    camera_px: Float[np.ndarray, "n 2"]
    projector_px: Float[np.ndarray, "n 2"]
    sure_pixels: Int[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


def join_pixels(codes: CodeMap, code: Code, *, fine_bits: int) -> Cells:
    """The mean camera position of each projector pixel, over the pixels that surely see it.

    A cell is the finest that the code tells apart: a value of the Gray code, one projector pixel of
    a phase code. Camera pixels whose finest bit is in doubt may be the next cell's; they count only
    where a cell has no others. Cells whose pixels lie farther apart than one surface puts them are
    left out.

    Raises:
        DecodeError: only one axis is coded.
    """
    plans = plan_axes(code, fine_bits)
    if len(plans) < 2:
        raise DecodeError(
            "averaging joins pixels with equal column and row, and the stack codes "
            f"{code.axes[0]}s only: remove --average, or project both axes"
        )
    decoded = codes.reason == Reason.DECODED
    number = np.zeros(int(decoded.sum()), dtype=np.int64)
    wrong = np.zeros(len(number))
    places, sigmas = (codes.column, codes.row), (codes.sigma_column, codes.sigma_row)
    for axis, position, sigma in zip(AXES, places, sigmas, strict=True):
        plan = plans[axis]
        cell_px = 1.0 if plan.periods else plan.cell_px
        cells = int(np.ceil(plan.size_px / cell_px)) + 1
        value = np.floor((position[decoded] - plan.first_px) / cell_px).astype(np.int64)
        number = number * cells + np.clip(value, 0, cells - 1)
        # A Gray value's variance is 1/12 and what doubt adds; a neighbour's is 1 away.
        wrong = np.maximum(wrong, (sigma[decoded] / cell_px) ** 2 - 1 / 12)
    y, x = np.nonzero(decoded)
    values = np.stack([x, y, codes.column[decoded], codes.row[decoded]], axis=-1).astype(np.float64)
    _, cell = np.unique(number, return_inverse=True)
    return _two_rounds(cell, values, wrong)


def _two_rounds(
    cell: Int[np.ndarray, " k"], values: Float[np.ndarray, "k 4"], wrong: Float[np.ndarray, " k"]
) -> Cells:
    """Means over the sure pixels; then over the others, of the cells that had none."""
    count = int(cell.max(initial=-1)) + 1
    mean, sure_pixels, whole = _means(cell, values, wrong <= MAX_WRONG, count)
    others, other_pixels, other_whole = _means(cell, values, wrong <= MAX_WRONG_ALONE, count)
    alone = (sure_pixels == 0) & (other_pixels > 0)
    mean[alone] = others[alone]
    good = np.where(alone, other_whole, whole)
    return Cells(
        camera_px=mean[good, :2], projector_px=mean[good, 2:], sure_pixels=sure_pixels[good]
    )


def _means(cell, values, subset: Bool[np.ndarray, " k"], count: int):
    """Mean of each cell's chosen pixels, their number, and whether they lie together."""
    cell, values = cell[subset], values[subset]
    pixels = np.bincount(cell, minlength=count)

    def mean(value) -> Float[np.ndarray, " n"]:
        return np.bincount(cell, value, count) / np.maximum(pixels, 1)

    centre = np.stack([mean(value) for value in values.T], axis=-1)
    off2_px2 = np.square(values[:, :2] - centre[cell, :2]).sum(axis=-1)
    limit_px = MAX_SCATTER * np.sqrt(pixels / (2 * np.pi)) + SCATTER_PX
    return centre, pixels, (pixels > 0) & (np.sqrt(mean(off2_px2)) <= limit_px)


def meet_rays(
    camera_px: Float[np.ndarray, "n 2"], projector_px: Float[np.ndarray, "n 2"], rig: Rig
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """The point halfway between two rays where they are nearest, and how far they miss.

    Returns:
        points in the camera frame [m], NaN where rays are parallel or meet behind a lens; the
        distance between the rays as seen from the projector [projector px]: the epipolar residual.

    Source: two-ray midpoint; e.g. Hartley & Sturm, "Triangulation", CVIU 68, 1997.
    """
    origin = rig.T_cam_proj[:3, 3]
    a = rays(rig.camera, camera_px)
    b = transform_points(rig.T_cam_proj, rays(rig.projector, projector_px)) - origin
    # Nearest points s a and origin + t b: (s a - t b - origin) is at right angles to both.
    aa, bb, ab = (np.einsum("ni,ni->n", u, v) for u, v in ((a, a), (b, b), (a, b)))
    ao, bo = a @ origin, b @ origin
    with np.errstate(divide="ignore", invalid="ignore"):
        across = aa * bb - ab * ab
        s = (bb * ao - ab * bo) / across
        t = (ab * ao - aa * bo) / across
    ahead = (s > 0) & (t > 0)
    s, t = np.where(ahead, s, np.nan), np.where(ahead, t, np.nan)
    on_camera_ray, on_projector_ray = s[:, None] * a, origin + t[:, None] * b
    gap_m = np.linalg.norm(on_camera_ray - on_projector_ray, axis=-1)
    focal_px = np.sqrt(rig.projector.fx_px * rig.projector.fy_px)
    return (on_camera_ray + on_projector_ray) / 2, gap_m / t * focal_px
