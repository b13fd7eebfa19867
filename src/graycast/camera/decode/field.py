"""Pixels that the projector's picture cannot reach, by the geometry of the rig alone."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from ...base.frames import transform_points
from ...rig.optics import Optics, picture_rays, project
from ...rig.pair import Rig


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
    ray = picture_rays(camera)
    near, far = (_sides(projector, np.array(T_proj_cam), ray * z_m) for z_m in (near_m, far_m))
    beside = (near & far).any(axis=0)
    beside.flags.writeable = False
    return beside


def _sides(
    projector: Optics, T_proj_cam: Float[np.ndarray, "4 4"], point: Float[np.ndarray, "h w 3"]
) -> Bool[np.ndarray, "4 h w"]:
    """Return beyond which sides of the picture points lie: left, right, top, bottom.

    A point behind the lens, or beyond the end of its model, lies beyond none.
    """
    x, y = np.moveaxis(project(projector, transform_points(T_proj_cam, point)), -1, 0)
    right, bottom = projector.width_px - 0.5, projector.height_px - 0.5
    with np.errstate(invalid="ignore"):  # NaN is neither < nor >
        return np.stack([x < -0.5, x > right, y < -0.5, y > bottom])
