"""The standard deviation of each depth of a dataset's view, which stores none.

Depth follows from a place in the projector's picture, so its noise is that place's, times how fast
depth changes with it. Where code maps are kept the decoder itself said the first; elsewhere it is
measured: how far pixels lie off the planes through their neighbours, at each strength of light.

Leaves out: what filters that average neighbours do. They make noise alike from pixel to pixel, and
what is alike is not seen off a plane: the sigma measured is then too small, that of code maps too
large.
"""

import numpy as np
from jaxtyping import Bool, Float, Num

from ...base.frames import transform_points
from ...base.robust import MAD_SIGMA
from ...camera.decode import triangulation_axis
from ...rig.optics import points, project
from ...rig.pair import Rig
from .view import planes_of

_GROUPS, _LEAST = 8, 400  # Each group has pixels of like light, and so many at least.
_NO_PLANES_PX = 12**-0.5  # Where no plane shows its noise, a place is known to a projector pixel.
_CENTRE = 24 / 25  # A plane through 25 pixels leaves this of the middle one's variance.
_NUDGE = 1e-4  # The depth's slope is taken over this share of it.


def depth_slope_m(depth_m: Float[np.ndarray, "h w"], rig: Rig) -> Float[np.ndarray, "h w"]:
    """How depth changes with the projector's coordinate [m/px]; NaN where there is none."""
    point_m = points(rig.camera, depth_m)
    axis = 0 if triangulation_axis(rig) == "column" else 1
    place = [
        project(rig.projector, transform_points(rig.T_proj_cam, at * point_m))
        for at in (1 - _NUDGE, 1 + _NUDGE)
    ]
    with np.errstate(divide="ignore"):
        return np.abs(2 * _NUDGE * depth_m / (place[1] - place[0])[..., axis])


def measured_noise_px(
    depth_m: Float[np.ndarray, "h w"],
    slope_m: Float[np.ndarray, "h w"],
    light: Num[np.ndarray, "h w"],
    rig: Rig,
) -> Float[np.ndarray, "h w"]:
    """Of each pixel's place in the projector [px], from how rough depth is where light is alike.

    Args:
        light: the modulation, in any unit.
    """
    _, smooth_m = planes_of(depth_m, rig.camera)
    off_px = np.abs(depth_m - smooth_m) / slope_m
    on_plane = np.isfinite(off_px)
    if not on_plane.any():
        return np.full(depth_m.shape, _NO_PLANES_PX)
    strength, noise_px = _by_light(light, off_px, on_plane)
    return np.interp(light, strength, noise_px)


def _by_light(
    light: Num[np.ndarray, "h w"],
    off_px: Float[np.ndarray, "h w"],
    on_plane: Bool[np.ndarray, "h w"],
) -> tuple[list[float], list[float]]:
    """Median light and noise of groups of equal size, the darkest first."""
    order = np.argsort(light[on_plane], kind="stable")
    groups = np.array_split(order, np.clip(len(order) // _LEAST, 1, _GROUPS))
    strength = [float(np.median(light[on_plane][group])) for group in groups]
    off = [float(np.median(off_px[on_plane][group])) for group in groups]
    return strength, [MAD_SIGMA * each / np.sqrt(_CENTRE) for each in off]
