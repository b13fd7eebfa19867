"""Removal of pixels that a nearer surface hides: they are out of order along an epipolar line.

The projector lights the first surface on each of its rays. So positions increase from pixel to
pixel along an epipolar line: between a near surface and the background, on the side away from the
projector, there is a shadow and not a step. Where positions decrease, the farther pixels must be
wrong, up to the pixel that is in order with the edge of the nearer surface.

Leaves out: objects so thin that the camera sees, past one side, background that the projector
lights past the other side. There the true order is reversed, and a strip of the background next to
them is removed; five scans of a Photoneo PhoXi have no such background either. Rows of the
camera (columns for a vertical baseline) are used as epipolar lines: in a rig with toe-in the two
differ by a fraction of a pixel over the few pixels next to an edge.
"""

import numpy as np
from jaxtyping import Float

from ...base.frames import transform_points
from ...base.kernels import kernel
from ...rig.optics import picture_rays, project
from ...rig.pair import Rig
from .maps import DepthMap
from .reasons import Reason
from .triangulation import triangulation_axis


def without_hidden(depth: DepthMap, rig: Rig, *, sigmas: float) -> DepthMap:
    """Remove pixels that are out of order next to a nearer surface.

    Args:
        sigmas: only pixels that are out of order by this many standard deviations are removed.

    Returns:
        A depth map whose hidden pixels are NaN with `Reason.OUTLIER`.
    """
    column = triangulation_axis(rig) == "column"
    known = np.isfinite(depth.depth_m)
    ray = picture_rays(rig.camera)[known]
    z_m, sigma_m = (m[known].astype(np.float64) for m in (depth.depth_m, depth.sigma_m))
    i = 0 if column else 1

    def place_at(z: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return project(rig.projector, transform_points(rig.T_proj_cam, ray * z[:, None]))[:, i]

    place, noise = (np.full(known.shape, np.nan) for _ in range(2))
    place[known] = place_at(z_m)
    noise[known] = np.abs(place_at(z_m + sigma_m) - place[known])
    sense = np.sign(rig.T_proj_cam[i, i])
    # Copies all have one memory layout, so the kernel is compiled only once.
    maps = [
        np.array(m if column else m.T, order="C") for m in (sense * place, noise, depth.depth_m)
    ]
    beside = np.zeros(maps[0].shape, dtype=np.bool_)
    _hide(*maps, sigmas, beside)
    return depth.without(beside if column else beside.T, Reason.OUTLIER)


@kernel()
def _hide(place, noise, z, sigmas, hidden):
    h, w = place.shape
    right = np.int64(1)  # For literals 1 and -1, numba would compile two versions.
    for y in range(h):
        last = np.int64(-1)  # The last pixel with depth
        for x in range(w):
            if np.isnan(place[y, x]):
                continue
            apart = sigmas * (noise[y, x] + noise[y, last])
            if last >= 0 and place[y, x] < place[y, last] - apart:
                if z[y, x] < z[y, last]:
                    _hide_beside(place[y], noise[y], sigmas, x, last, right, hidden[y])
                else:
                    _hide_beside(place[y], noise[y], sigmas, last, x, -right, hidden[y])
            last = np.int64(x)


@kernel()
def _hide_beside(place, noise, sigmas, near, far, way, hidden):
    """Mark pixels from `far` on, away from `near`, until they are in order with `near`.

    `way` is 1 if the near surface is to the right, else -1.
    """
    x = far
    while 0 <= x < len(place):
        if not np.isnan(place[x]):
            if way * (place[x] - place[near]) <= sigmas * (noise[x] + noise[near]):
                break  # The shadow ends here.
            hidden[x] = True
        x -= way
