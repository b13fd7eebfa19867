"""Camera pixels that the projector cannot reach, computed from the geometry of the rig."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool

from ...base.kernels import kernel
from ...rig.optics import Optics, picture_rays
from ...rig.pair import Rig
from .meeting import lens_of, place_px, rows_of


def beside_projector(rig: Rig) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the camera pixels that the projector cannot light in the working range.

    A pixel sees the part of its ray between `near_m` and `far_m`, whose image in the projector is
    nearly a straight line. If both ends are beyond the same side of the projector's picture, so is
    the whole line. The mask is read-only and is cached for the latest rigs.

    Leaves out: lines that pass a corner outside the picture, and rays that are outside it only at
    the depth of the surface. The decoder does not know that depth, so it cannot distinguish such a
    pixel from one in shadow.
    """
    T_proj_cam = tuple(map(tuple, rig.T_proj_cam.tolist()))
    return _beside(rig.camera, rig.projector, T_proj_cam, rig.near_m, rig.far_m)


@lru_cache(maxsize=8)
def _beside(
    camera: Optics,
    projector: Optics,
    T_proj_cam: tuple[tuple[float, ...], ...],
    near_m: float,
    far_m: float,
) -> Bool[np.ndarray, "h w"]:
    ray = picture_rays(camera).reshape(-1, 3)
    beside = np.empty((camera.height_px, camera.width_px), dtype=np.bool_)
    T, lens = rows_of(np.array(T_proj_cam), 0), lens_of(projector, 0)
    _mark_beside(ray, float(near_m), float(far_m), T, lens, beside.reshape(-1))
    beside.flags.writeable = False
    return beside


@kernel(error_model="numpy")
def _mark_beside(ray, near_m, far_m, T, lens, beside):
    """Write whether both ends of each ray are beyond the same side of the projector's picture.

    A point behind the lens, or outside the lens model, is NaN, and the result is then false.
    """
    for n in range(len(ray)):
        u, v = place_px(ray, n, near_m, T, lens)
        x, y = place_px(ray, n, far_m, T, lens)
        beside[n] = (
            (u < -0.5 and x < -0.5)
            or (u > lens.end_u and x > lens.end_u)
            or (v < -0.5 and y < -0.5)
            or (v > lens.end_v and y > lens.end_v)
        )
