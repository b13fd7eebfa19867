"""Picture of the residuals between the measured depth and the fitted bin."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...base.frames import transform_points
from ...base.plotting import ACCENT, INK, PALE, SECOND, caption, plain_axes, save_png
from .bin_views import BinView
from .pose_fit import PoseFit
from .shape import NO_FACE, BinShape, height_over

_RANGE_M = 0.006  # Depth farther from the model does not belong to the bin.
_ACROSS_PX = 640
_BELOW = (0.5, -0.1)  # position of the legend, as a share of the axes' size


def draw_residuals(pose: PoseFit, shape: BinShape, views: Sequence[BinView], path: Path) -> None:
    """Draw the first view's signed residuals, and the spread and agreement of each surface, as PNG.

    Raises:
        GraycastError: the file cannot be written.
    """
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
    limit_mm = 1e3 * max(3 * pose.rms_m, 0.3e-3)
    residual_mm = 1e3 * residual_map(views[0], shape, pose.T_world_cam)
    image = left.imshow(residual_mm, cmap="RdBu_r", vmin=-limit_mm, vmax=limit_mm)
    bar = figure.colorbar(image, ax=left, shrink=0.85)
    bar.set_label("above its face [mm]", fontsize=8, color=INK)
    caption(left, f"residuals of {Path(views[0].name).name}", "column [px]", "row [px]")
    bar.ax.tick_params(labelsize=8)
    left.tick_params(labelsize=8)
    left.set_facecolor(PALE)
    _draw_spread(middle, pose)
    _draw_agreement(right, pose)
    save_png(figure, path, dpi=110)


def residual_map(
    view: BinView, shape: BinShape, T_world_cam: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "rows columns"]:
    """Return the signed distance [m] of each pixel's point from the face that is expected there.

    It is NaN where no depth is measured, no face is expected, or something else hides the face.
    """
    grid = view.grid(_ACROSS_PX)
    face, _ = shape.cast(T_world_cam, grid)
    height_m = height_over(shape, transform_points(T_world_cam, grid.point_m), face)
    with np.errstate(invalid="ignore"):
        mine = (face != NO_FACE) & (np.abs(height_m) < _RANGE_M)
    return np.where(mine, height_m, np.nan)


def _draw_spread(ax: Axes, pose: PoseFit) -> None:
    faces = [face for face in pose.faces if np.isfinite(face.rms_m)][::-1]
    y = np.arange(len(faces))
    ax.barh(y, [1e3 * face.p95_m for face in faces], color="#cfe3ec", label="95 % within")
    ax.barh(y, [1e3 * face.rms_m for face in faces], height=0.4, color=ACCENT, label="RMS")
    median = [1e3 * face.median_m for face in faces]
    ax.plot(median, y, "D", color=SECOND, ms=4, label="median, signed")
    ax.set_yticks(y, [face.name for face in faces], fontsize=8)
    ax.legend(fontsize=7, frameon=False, ncols=3, loc="upper center", bbox_to_anchor=_BELOW)
    plain_axes(ax, grid="x")
    caption(ax, "residuals of inliers", "mm")


def _draw_agreement(ax: Axes, pose: PoseFit) -> None:
    faces = [face for face in pose.faces if face.seen_px][::-1]
    y = np.arange(len(faces))
    ax.barh(y, [1e2 * face.measured for face in faces], color=PALE, label="measured")
    ax.barh(y, [1e2 * face.inliers for face in faces], height=0.5, color=ACCENT, label="agree")
    ax.set_yticks(y, [face.name for face in faces], fontsize=8)
    ax.set_xlim(0, 100)
    ax.legend(fontsize=7, frameon=False, ncols=3, loc="upper center", bbox_to_anchor=_BELOW)
    plain_axes(ax, grid="x")
    caption(ax, "of the pixels that should show it", "%")
