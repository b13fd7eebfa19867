"""Pixels that the projector's picture cannot reach, by the geometry of the rig alone."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool

from ...base.kernels import kernel
from ...rig.optics import Optics, picture_rays
from ...rig.pair import Rig
from .meeting import lens_of, place_px, rows_of


def beside_projector(rig: Rig) -> Bool[np.ndarray, "h w"]:
    """Return the camera pixels that see nothing within the working range that the projector lights.

    What a pixel can see lies on its ray between `near_m` and `far_m`, whose image in the projector
    is nearly a straight line. Where both ends lie beyond one side of the projector's picture, so
    does the whole line. The result is read-only, and the last rigs' are kept.

    Leaves out: lines that pass a corner of the picture, and what lies beside the picture only at
    the depth where the surface is. The decoder does not know that depth, and cannot tell such a
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
    """Write whether both ends of each ray lie beyond the same side of the projector's picture.

    A point behind the lens, or beyond the end of its model, is NaN and lies beyond none.
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
