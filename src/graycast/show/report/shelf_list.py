"""List the named scanners, or those that measure a required field accurately enough."""

import numpy as np
from jaxtyping import Float
from manifold3d import CrossSection, FillRule

from ...camera.scanner import Scanner, preset
from ...rig.pair import PRESETS, Rig
from ...rig.shelf import class_of, measured
from .rig_picture import common_field

Size = tuple[float, float]


def shelf_lines(
    *, field_m: Size | None = None, at_m: float | None = None, noise_m: float | None = None
) -> list[str]:
    """Return a line for each suitable scanner; numbers are marked with the class of their source.

    `rig.shelf.LEGEND` explains the classes.

    Args:
        field_m: sides of a rectangle that must fit into the common field at `at_m`, or None.
        at_m: a distance along the camera's axis, inside the working range. The line states the
            field at this distance, or at the middle of the range if it is None.
        noise_m: the largest temporal noise of depth (one sigma) at `at_m`. A scanner without
            a measured noise is then not suitable.
    """
    lines = []
    for name in PRESETS:
        scanner = preset(name, "full")
        rig = scanner.rig
        z_m = (rig.near_m + rig.far_m) / 2 if at_m is None else at_m
        own_m = None if at_m is None else stored_noise_m(name, at_m)
        if (
            rig.near_m <= z_m <= rig.far_m
            and (field_m is None or covers(rig, field_m, z_m))
            and (noise_m is None or (own_m is not None and own_m <= noise_m))
        ):
            lines.append(_line(scanner, z_m, own_m))
    return lines


def covers(rig: Rig, field_m: Size, z_m: float) -> bool:
    """Return whether a rectangle fits into the common field at a depth, along x or along y.

    A convex field contains a rectangle around a point if it contains the four corners. This is true
    for a point that the four fields, shifted by the four corners, have in common.
    """
    field = common_field(rig, z_m)
    if not len(field):
        return False
    outline = CrossSection([field], FillRule.NonZero)
    return any(_holds(outline, np.array(size) / 2) for size in (field_m, field_m[::-1]))


def _holds(outline: CrossSection, half_m: Float[np.ndarray, "2"]) -> bool:
    common = outline.translate(half_m)
    for sign in ((1, -1), (-1, 1), (-1, -1)):
        common = common ^ outline.translate(half_m * sign)
    return not common.is_empty()


def stored_noise_m(name: str, z_m: float) -> float | None:
    """Return the temporal noise of depth at a distance, from three measured distances.

    An error of the projector position causes a depth error proportional to `z^2 / (f b)` (similar
    triangles). Therefore noise divided by `z^2` is interpolated linearly between the three
    distances; it is constant outside. The result is None if the scanner has not been measured.
    """
    own = measured().scanners.get(name)
    if own is None:
        return None
    at_m = np.array(own.z_m)
    return float(z_m**2 * np.interp(z_m, at_m, own.noise_m / at_m**2))


def _line(scanner: Scanner, z_m: float, noise_m: float | None) -> str:
    rig, camera = scanner.rig, scanner.rig.camera
    field = common_field(rig, z_m)
    width_m, height_m = np.ptp(field, axis=0) if len(field) else (0.0, 0.0)
    noise = "" if noise_m is None else f", noise {1e3 * noise_m:.3f} mm"
    span = class_of(rig.name, "near_m", "far_m")
    baseline = class_of(rig.name, "baseline_m", "t_cam_proj_m")
    pixels = class_of(rig.name, "camera.size_px")
    return (
        f"{rig.name:22}  {rig.near_m:.2f} to {rig.far_m:.2f} m [{span}], baseline "
        f"{1e3 * rig.baseline_m:.0f} mm [{baseline}], {camera.width_px} x {camera.height_px} "
        f"pixels [{pixels}], code {scanner.code.codec} [choice], field {width_m:.2f} x "
        f"{height_m:.2f} m at {z_m:.2f} m{noise}"
    )
