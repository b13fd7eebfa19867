"""Compiled intersection of camera rays with projector planes, pixel by pixel.

`triangulation` has the equations; `tests/camera/decode/plain_meeting.py` has the same computation
in NumPy. The kernels use one thread: 5 million pixels take a quarter of a second, and numba takes
longer than that to compile loops for several threads.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.kernels import kernel
from ...rig.lens_inverse import undistorted
from ...rig.optics import Optics, fold_radius2

DISTORTION_ITERATIONS = 5


class Lens(NamedTuple):
    """The numbers of `Optics` that kernels use, in a frame whose first axis is the coded one.

    `u` is along the first axis and `v` along the second. `end_u` and `end_v` are the far borders of
    the picture; `fold2` is the squared radius at which the lens model ends; `swapped` is true if
    rows are the coded axis.
    """

    focal_u: float
    focal_v: float
    centre_u: float
    centre_v: float
    end_u: float
    end_v: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    fold2: float
    distorted: bool
    swapped: bool


def lens_of(optics: Optics, coded: int) -> Lens:
    """Return the numbers of a projector whose coded axis is x (0) or y (1)."""
    u, v = (0, 1) if coded == 0 else (1, 0)
    focal = float(optics.fx_px), float(optics.fy_px)
    centre = float(optics.cx_px), float(optics.cy_px)
    fold2 = fold_radius2(optics.distortion) if optics.has_distortion else math.inf
    end = optics.width_px - 0.5, optics.height_px - 0.5
    k1, k2, p1, p2, k3 = map(float, optics.distortion)
    return Lens(
        focal_u=focal[u],
        focal_v=focal[v],
        centre_u=centre[u],
        centre_v=centre[v],
        end_u=end[u],
        end_v=end[v],
        k1=k1,
        k2=k2,
        p1=p1,
        p2=p2,
        k3=k3,
        fold2=fold2,
        distorted=optics.has_distortion,
        swapped=coded == 1,
    )


def rows_of(T_proj_cam: Float[np.ndarray, "4 4"], coded: int) -> Float[np.ndarray, "3 4"]:
    """Return the rows of a pose for the coded axis, the other axis and z."""
    return np.ascontiguousarray(T_proj_cam[[coded, 1 - coded, 2]], dtype=np.float64)


@kernel(error_model="numpy")
def meet(ray, across, along, T, lens, depth_m, slope_m):
    """Write the depth of each ray and its derivative by the coded position `across` [m/px].

    If `along` is NaN, it was not decoded and is computed from the depth by iteration. Return
    false if the lens distortion has no inverse at one of the projector positions.
    """
    sound = True
    for n in range(len(ray)):
        depth_m[n], slope_m[n], good = _meet_ray(ray, n, across[n], along[n], T, lens)
        sound &= good
    return sound


@kernel(error_model="numpy")
def off_the_line_px(ray, depth_m, along, T, lens, off_px):
    """Write the decoded position along the planes minus the position of the measured point [px]."""
    for n in range(len(ray)):
        off_px[n] = along[n] - place_px(ray, n, depth_m[n], T, lens)[1]


@kernel(error_model="numpy")
def _meet_ray(ray, n, across, along, T, lens):
    """Return depth and slope for one ray, and whether the distortion has an inverse for it."""
    terms = (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3)
    u = (across - lens.centre_u) / lens.focal_u
    v = (along - lens.centre_v) / lens.focal_v
    decoded = math.isfinite(v)
    ideal, sound, rounds = u, True, 0
    if lens.distorted:
        rounds = 1 if decoded else DISTORTION_ITERATIONS
    facing, ahead = _faces(ray, n, ideal, T)
    z = (ideal * T[2, 3] - T[0, 3]) / facing
    for _ in range(rounds):
        if not decoded:
            # A lit point is in the picture. Wrong codes can lead outside, where the distortion may
            # fold over, so the position is clamped.
            guess = place_px(ray, n, z, T, lens)[1]
            guess = min(max(guess, -0.5), lens.end_v) if guess == guess else guess
            v = (guess - lens.centre_v) / lens.focal_v
        ideal = math.nan
        if math.isfinite(u) and math.isfinite(v):
            x, y = (v, u) if lens.swapped else (u, v)
            x, y, good = undistorted(x, y, terms)
            ideal = y if lens.swapped else x
            sound &= good
        facing, ahead = _faces(ray, n, ideal, T)
        z = (ideal * T[2, 3] - T[0, 3]) / facing
    return z, (T[2, 3] + z * ahead) / facing / lens.focal_u, sound


@kernel(error_model="numpy")
def _faces(ray, n, ideal, T):
    """Return the rates along a ray at which the plane's equation and the projector's z change."""
    x, y, z = ray[n, 0], ray[n, 1], ray[n, 2]
    ahead = x * T[2, 0] + y * T[2, 1] + z * T[2, 2]
    return x * T[0, 0] + y * T[0, 1] + z * T[0, 2] - ideal * ahead, ahead


@kernel(error_model="numpy")
def place_px(ray, n, depth_m, T, lens):
    """Return the projector position (u, v) of a point on a ray; NaN outside the lens model."""
    x, y, z = ray[n, 0] * depth_m, ray[n, 1] * depth_m, ray[n, 2] * depth_m
    far = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if not far > 0:
        return math.nan, math.nan
    a = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / far
    b = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / far
    r2 = a * a + b * b
    if not r2 < lens.fold2:
        return math.nan, math.nan
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    # The tangential terms of y use p1 where the terms of x use p2.
    p, q = (lens.p2, lens.p1) if lens.swapped else (lens.p1, lens.p2)
    u = a * radial + 2 * p * a * b + q * (r2 + 2 * a * a)
    v = b * radial + p * (r2 + 2 * b * b) + 2 * q * a * b
    return lens.focal_u * u + lens.centre_u, lens.focal_v * v + lens.centre_v
