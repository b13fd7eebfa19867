"""Pixels out of order along their epipolar line, which a nearer surface must hide.

The projector lights the first surface on each of its rays, so along an epipolar line positions rise
from pixel to pixel wherever surfaces are wider than what they hide: between a near surface and what
lies behind it, on the side away from the projector, there is a shadow and never a step. Where
positions fall all the same, the farther pixels are taken for wrong, as far as they are out of order
with the nearer surface's edge.

Leaves out: things so thin that one sees past them what the projector lights past their other side.
There the order is another one in truth, and a strip of the background goes beside them; real
scanners (five scans of a Photoneo PhoXi) have no such steps either. Epipolar lines are taken as the
camera's rows (columns, where the baseline runs down): over the few pixels beside an edge a toed-in
rig's lines leave them by a fraction of a pixel.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...base.frames import transform_points
from ...base.kernels import kernel
from ...rig.optics import picture_rays, project
from ...rig.pair import Rig
from .maps import DepthMap, Reason
from .triangulation import triangulation_axis


def without_hidden(depth: DepthMap, rig: Rig, *, sigmas: float) -> DepthMap:
    """The same depth without pixels out of order beside a nearer surface.

    Args:
        sigmas: by how many standard deviations of both positions they must be out of order.

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
    # Copies, so that the kernel is compiled for one kind of array alone.
    maps = [
        np.array(m if column else m.T, order="C") for m in (sense * place, noise, depth.depth_m)
    ]
    beside = np.zeros(maps[0].shape, dtype=np.bool_)
    _hide(*maps, sigmas, beside)
    hidden = beside if column else beside.T
    nothing = np.float32(np.nan)
    return replace(
        depth,
        depth_m=np.where(hidden, nothing, depth.depth_m),
        sigma_m=np.where(hidden, nothing, depth.sigma_m),
        reason=np.where(hidden, np.uint8(Reason.OUTLIER), depth.reason),
    )


@kernel()
def _hide(place, noise, z, sigmas, hidden):
    h, w = place.shape
    right = np.int64(1)  # a number of its own would be compiled for by itself, as -1 would
    for y in range(h):
        last = np.int64(-1)  # the last pixel that has depth
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

    `way` is 1 where the near surface lies to the right.
    """
    x = far
    while 0 <= x < len(place):
        if not np.isnan(place[x]):
            if way * (place[x] - place[near]) <= sigmas * (noise[x] + noise[near]):
                break  # the shadow ends here
            hidden[x] = True
        x -= way
