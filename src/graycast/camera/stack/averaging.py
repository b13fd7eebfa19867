"""Average all camera pixels that see the same projector pixel into one point."""

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

# These are limits of the probability that a pixel belongs to the adjacent cell. Pixels below the
# first are used; a cell without such pixels uses pixels below the second.
MAX_WRONG, MAX_WRONG_ALONE = 0.02, 0.2
# The n pixels of a cell scatter about their mean by sqrt(n / 2 pi) if they fill a disc, or more if
# they fill an ellipse on a slanted surface. A larger scatter means that there are several surfaces.
MAX_SCATTER, SCATTER_PX = 2.0, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Cells of the projector that the camera sees, with their mean positions in both pictures.

    `sure_pixels` is the number of camera pixels that were averaged; 0 if all are uncertain.
    """

    camera_px: Float[np.ndarray, "n 2"]
    projector_px: Float[np.ndarray, "n 2"]
    sure_pixels: Int[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


def join_pixels(codes: CodeMap, code: Code, *, fine_bits: int) -> Cells:
    """Average the positions of the camera pixels that see the same cell of the projector.

    A cell is the finest unit that the code resolves: a value of the Gray code, or one projector
    pixel of a phase code. A camera pixel whose finest bit is uncertain may belong to the adjacent
    cell; it counts only if its cell has no certain pixels. Cells whose pixels are too far apart for
    one surface are left out.

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
        # The variance in excess of 1/12 is the probability of being one Gray value off.
        wrong = np.maximum(wrong, (sigma[decoded] / cell_px) ** 2 - 1 / 12)
    y, x = np.nonzero(decoded)
    values = np.stack([x, y, codes.column[decoded], codes.row[decoded]], axis=-1).astype(np.float64)
    _, cell = np.unique(number, return_inverse=True)
    return _two_rounds(cell, values, wrong)


def _two_rounds(
    cell: Int[np.ndarray, " k"], values: Float[np.ndarray, "k 4"], wrong: Float[np.ndarray, " k"]
) -> Cells:
    """Average the certain pixels of each cell; in a cell without any, average uncertain pixels."""
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
    """Return the mean of each cell's pixels, their number, and whether they are close together."""
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
    """Return the midpoint of the shortest connection between two rays, and its length.

    Returns:
        Points in the camera frame [m], NaN if rays are parallel or meet behind a lens; and the
        epipolar residual, which is the distance of the rays seen from the projector [projector px].

    Source: two-ray midpoint; e.g. Hartley & Sturm, "Triangulation", CVIU 68, 1997.
    """
    origin = rig.T_cam_proj[:3, 3]
    a = rays(rig.camera, camera_px)
    b = transform_points(rig.T_cam_proj, rays(rig.projector, projector_px)) - origin
    # Nearest points are s a and origin + t b: (s a - t b - origin) is perpendicular to both rays.
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
