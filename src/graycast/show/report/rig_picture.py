"""A rig as a picture and as text: the fields of camera and projector, and their common field.

All drawings are in the camera frame: x right, y down, z depth. A field is traced from the borders
of the image through the lens model, with distortion but without occlusion, focus and light.
"""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float
from manifold3d import CrossSection, FillRule
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...base.plotting import save_png
from ...camera.decode import triangulation_axis
from ...rig.optics import Optics, rays
from ...rig.pair import Rig, depth_per_line_m

_CAMERA, _PROJECTOR, _COMMON = "tab:blue", "tab:red", "tab:purple"
_BORDER_POINTS = 33  # number of points on each side of a border, because distortion bends it
_DEPTHS = 61
_WIDTH_IN, _PLOTS_IN, _WORDS_IN = 15.0, 12.6, 0.9  # `_WORDS_IN` is the space for labels.


def footprint_m(
    optics: Optics, T_cam_device: Float[np.ndarray, "4 4"], z_m: float
) -> Float[np.ndarray, "n 2"]:
    """Return the outline (x, y) of a device's field on the plane z = `z_m` in the camera frame.

    Args:
        optics: the camera or the projector.
        T_cam_device: transform from the device's frame to the camera frame.
        z_m: depth of the plane [m], camera frame.

    Returns:
        Corners of the outline in order [m]; empty if a border ray does not meet the plane.
    """
    direction = rays(optics, _border_px(optics)) @ T_cam_device[:3, :3].T
    origin = T_cam_device[:3, 3]
    reach = (z_m - origin[2]) / np.where(direction[:, 2] > 1e-6, direction[:, 2], np.nan)
    if not (reach > 0).all():
        return np.zeros((0, 2))
    return origin[:2] + reach[:, None] * direction[:, :2]


def common_field(rig: Rig, z_m: float) -> Float[np.ndarray, "n 2"]:
    """Return the outline (x, y) of the common field at depth `z_m`, in the camera frame.

    If distorted outlines overlap in several pieces, return the largest; empty without overlap.
    """
    outlines = (
        footprint_m(rig.camera, np.eye(4), z_m),
        footprint_m(rig.projector, rig.T_cam_proj, z_m),
    )
    camera, projector = (CrossSection([one], FillRule.NonZero) for one in outlines)
    common = camera ^ projector
    if common.is_empty():
        return np.zeros((0, 2))
    return max(common.decompose(), key=lambda piece: piece.area()).to_polygons()[0]


def describe_rig(rig: Rig) -> str:
    """Return the rig's figures as text, one per line, with lengths in mm and angles in degrees."""
    lines = [
        f"rig {rig.name}",
        f"  baseline          {1e3 * rig.baseline_m:.1f} mm",
        f"  toe-in            {math.degrees(rig.axes_angle_rad):.2f} deg between the axes",
        f"  working range     {1e3 * rig.near_m:.0f} to {1e3 * rig.far_m:.0f} mm",
        f"  camera            {_optics_words(rig.camera)}",
        f"  projector         {_optics_words(rig.projector)}",
        f"  depth           {f'one {triangulation_axis(rig)}':>13}   common field",
    ]
    for name, z_m in _stations(rig):
        line_mm = 1e3 * depth_per_line_m(rig, z_m, triangulation_axis(rig))
        step = "not lit on axis" if math.isnan(line_mm) else f"{line_mm:.3f} mm"
        lines.append(f"  {name:6} {1e3 * z_m:6.0f} mm  {step:>12}   {_field_words(rig, z_m)}")
    return "\n".join(lines)


def draw_rig(rig: Rig, path: Path) -> None:
    """Write a PNG with the rig from above and from the side, depth per column or row, and fields.

    Raises:
        GraycastError: the file cannot be written.
    """
    figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN), layout="constrained")
    rows = figure.add_gridspec(2, 1)
    above, below = rows[0].subgridspec(1, 3), rows[1].subgridspec(1, 3)
    axes = np.array([[figure.add_subplot(row[k]) for k in range(3)] for row in (above, below)])
    _draw_view(axes[0, 0], rig, across=0)
    _draw_view(axes[0, 1], rig, across=1)
    _draw_depth_per_line(axes[0, 2], rig)
    for ax, (name, z_m) in zip(axes[1], _stations(rig), strict=True):
        _draw_fields(ax, rig, name, z_m)
    _share_limits(axes[1])
    _share_scale(axes[0, :2])
    # The heights of the rows fit their drawings at one scale, so that no space remains empty.
    spans = [abs(np.diff(ax.get_xlim()).item()) for ax in axes[0, :2]]
    above.set_width_ratios([*spans, sum(spans) / 2])
    depth = abs(np.diff(axes[0, 0].get_ylim()).item())
    heights_in = [
        _PLOTS_IN * depth / (1.5 * sum(spans)) + _WORDS_IN,
        _PLOTS_IN * axes[1, 0].get_data_ratio() / 3 + _WORDS_IN,
    ]
    rows.set_height_ratios(heights_in)
    figure.set_size_inches(_WIDTH_IN, sum(heights_in) + 2 * _WORDS_IN / 3)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    toe_in = f"toe-in {math.degrees(rig.axes_angle_rad):.2f}° between the axes"
    figure.suptitle(f"{rig.name}: baseline {1e3 * rig.baseline_m:.1f} mm, {toe_in}")
    save_png(figure, path, dpi=100)


def _draw_view(ax: Axes, rig: Rig, *, across: int) -> None:
    """Draw a view with depth downwards, from above (`across` = 0, x) or from the side (1, y)."""
    bottom_m = rig.far_m + 0.08 * (rig.far_m - rig.near_m)
    devices = (
        ("camera", rig.camera, np.eye(4), _CAMERA),
        ("projector", rig.projector, rig.T_cam_proj, _PROJECTOR),
    )
    for name, optics, T_cam_device, color in devices:
        origin = T_cam_device[:3, 3]
        edges = _edges(footprint_m(optics, T_cam_device, bottom_m), across)
        triangle = np.array([[origin[across], origin[2]], *([edge, bottom_m] for edge in edges)])
        ax.fill(*(1e3 * triangle.T), color=color, alpha=0.12, lw=0, label=f"{name}'s field")
        ax.plot(*(1e3 * triangle[[1, 0, 2]].T), color=color, lw=1)
        ax.plot(1e3 * origin[across], 1e3 * origin[2], "o", color=color, ms=8, label=name)
        direction = T_cam_device[:3, 2]
        if direction[2] > 0:
            end = origin + direction * (bottom_m - origin[2]) / direction[2]
            line = np.stack([origin, end])[:, [across, 2]]
            ax.plot(*(1e3 * line.T), "--", color=color, lw=1)
    z_m = np.linspace(rig.near_m, rig.far_m, _DEPTHS)
    low, high = np.transpose([_edges(common_field(rig, z), across) for z in z_m])
    ax.fill_betweenx(
        1e3 * z_m, 1e3 * low, 1e3 * high, lw=0, color=_COMMON, alpha=0.35, label="common volume"
    )
    base = np.stack([np.zeros(3), rig.T_cam_proj[:3, 3]])
    ax.plot(*(1e3 * base[:, [across, 2]].T), color="black", lw=2, label="baseline")
    for name, z in (("near", rig.near_m), ("far", rig.far_m)):
        ax.axhline(1e3 * z, color="gray", ls=":")
        ax.annotate(
            name, (0.01, 1e3 * z), xycoords=("axes fraction", "data"), va="bottom", color="gray"
        )
    # The field of a device that looks sideways is unlimited, so the view has the rig's size.
    widest_mm = 2e3 * max(bottom_m, rig.baseline_m)
    left_mm, right_mm = ax.get_xlim()
    ax.set_xlim(max(left_mm, -widest_mm), min(right_mm, widest_mm))
    ax.set_aspect("equal")
    ax.invert_yaxis()
    ax.set(
        title=("from above (x, z)", "from the side (y, z)")[across],
        xlabel=("x, right [mm]", "y, down in the image [mm]")[across],
        ylabel="depth z [mm]",
    )


def _draw_depth_per_line(ax: Axes, rig: Rig) -> None:
    z_m, axis = np.linspace(rig.near_m, rig.far_m, _DEPTHS), triangulation_axis(rig)
    step_m = np.array([depth_per_line_m(rig, z, axis) for z in z_m])
    ax.plot(1e3 * z_m, 1e3 * step_m, color="black")
    for name, z in _stations(rig):
        here_mm = 1e3 * depth_per_line_m(rig, z, axis)
        if math.isfinite(here_mm):
            ax.plot(1e3 * z, here_mm, "o", color="black")
            text = f"{name}: {here_mm:.3f} mm"
            ax.annotate(text, (1e3 * z, here_mm), (6, -12), textcoords="offset points")
    ax.set(
        title=f"depth per projector {axis}, camera's axis",
        xlabel="depth z [mm]",
        ylabel=f"depth per {axis} [mm]",
        xlim=(1e3 * rig.near_m, 1e3 * (rig.far_m + 0.4 * (rig.far_m - rig.near_m))),
    )
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3)


def _draw_fields(ax: Axes, rig: Rig, name: str, z_m: float) -> None:
    camera = footprint_m(rig.camera, np.eye(4), z_m)
    projector = footprint_m(rig.projector, rig.T_cam_proj, z_m)
    for outline, color in ((camera, _CAMERA), (projector, _PROJECTOR)):
        ax.fill(*(1e3 * outline.T), fc="none", ec=color)
    ax.fill(*(1e3 * common_field(rig, z_m).T), color=_COMMON, alpha=0.35, lw=0)
    ax.set_aspect("equal")
    ax.invert_yaxis()
    ax.set(
        title=f"{name}, {1e3 * z_m:.0f} mm: {_field_words(rig, z_m)}",
        xlabel="x, right [mm]",
        ylabel="y, down [mm]",
    )


def _share_limits(axes: np.ndarray) -> None:
    """Give all fields the same scale, so that their sizes can be compared."""
    x = [limit for ax in axes for limit in ax.get_xlim()]
    y = [limit for ax in axes for limit in ax.get_ylim()]
    for ax in axes:
        ax.set_xlim(min(x), max(x))
        ax.set_ylim(max(y), min(y))


def _share_scale(axes: np.ndarray) -> None:
    """Give both views the same range of depth, so that lengths can be compared."""
    bottom, top = axes[0].get_ylim()
    for ax in axes:
        low, high = ax.get_ylim()
        bottom, top = max(bottom, low), min(top, high)
    for ax in axes:
        ax.set_ylim(bottom, top)


def _stations(rig: Rig) -> tuple[tuple[str, float], ...]:
    middle_m = 0.5 * (rig.near_m + rig.far_m)
    return ("near", rig.near_m), ("middle", middle_m), ("far", rig.far_m)


def _optics_words(optics: Optics) -> str:
    horizontal, vertical = (math.degrees(angle) for angle in optics.field_of_view_rad)
    size = f"{optics.width_px} x {optics.height_px} px"
    lens = "distorted" if optics.has_distortion else "no distortion"
    return f"{size}, field {horizontal:.2f} x {vertical:.2f} deg, {lens}"


def _field_words(rig: Rig, z_m: float) -> str:
    """Return the size of the common field's enclosing rectangle as text, or "none"."""
    field = common_field(rig, z_m)
    if not len(field):
        return "none"
    width_mm, height_mm = 1e3 * np.ptp(field, axis=0)
    return f"{width_mm:.0f} x {height_mm:.0f} mm"


def _edges(outline: Float[np.ndarray, "n 2"], across: int) -> tuple[float, float]:
    """Return the smallest and largest coordinate along an axis; NaN for an empty outline."""
    if not len(outline):
        return math.nan, math.nan
    return outline[:, across].min(), outline[:, across].max()


def _border_px(optics: Optics) -> Float[np.ndarray, "n 2"]:
    """Return points along the outer pixel borders, once around the image."""
    right, bottom = optics.width_px - 0.5, optics.height_px - 0.5
    t = np.linspace(0.0, 1.0, _BORDER_POINTS)[:-1, None]
    corner = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    following = np.roll(corner, -1, axis=0)
    return np.concatenate([a + t * (b - a) for a, b in zip(corner, following, strict=True)])
