"""Checks for depth in a wrong unit, filled holes, and ray lengths that were read as z."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from ..base.errors import DatasetError
from ..rig.optics import Optics, picture_rays

BEYOND = 1.5  # A median depth above far * BEYOND or below near / BEYOND means a wrong unit.
FILLED = 0.05  # If more of the known pixels have the farthest depth, it may be a fill value.
_APART = 1.2  # A farthest depth this many times the second farthest is a fill value.
_PIXELS, _PLANES = 3000, 300  # sampled pixels, and sampled triples of them, for the largest plane
_LEAST_PX = 300
_OFF = 3e-3  # largest distance of an inlier from the plane, as a share of its depth
_PLANE_SHARE, _TIMES = 0.1, 2.0  # least share of pixels on the plane; least ratio of both shares
_FEWER = 5  # A fill value is at least this many times as frequent as the depths just below it.

AnyDepth = Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"]


def refuse_beyond(depth_m: AnyDepth, *, near_m: float, far_m: float, name: str, whose: str) -> None:
    """Refuse depth that is far outside a known range, for example because of a wrong unit.

    Args:
        depth_m: z [m]; NaN where it is missing. A map without any depth is not refused.
        whose: words before the range in the error, such as "the detector learnt".

    Raises:
        DatasetError: the median depth is far outside the range (see `BEYOND`).
    """
    known = depth_m[np.isfinite(depth_m)]
    middle_m = float(np.median(known)) if known.size else near_m
    if not near_m / BEYOND <= middle_m <= BEYOND * far_m:
        raise DatasetError(
            f"{name}: the median depth is {middle_m:.4g} m, and {whose} {near_m:.4g} to "
            f"{far_m:.4g} m: probably the depth has another unit, so correct the scale (0.001 for "
            "millimetres, 0.0001 for tenths of them)"
        )


def filled_holes(depth_m: AnyDepth, name: str) -> str | None:
    """Return a warning about holes that are filled with the farthest depth; None if there are none.

    Pixels at exactly the farthest depth count as filled if they are many. Few such pixels count as
    filled if no other depth is near, as with a sentinel of 65.535 m.

    Leaves out: a wall at one exact depth, as in a perfect depth map, is mistaken for filled holes.
    """
    known = depth_m[np.isfinite(depth_m)]
    if not known.size:
        return None
    value, count = np.unique(known, return_counts=True)
    farthest_m, filled = value[-1], int(count[-1])
    apart = filled >= _FEWER and len(value) > 1 and farthest_m > _APART * value[-2]
    common = filled >= FILLED * known.size and filled >= _FEWER * count[-4:-1].max(initial=0)
    if not (apart or common):
        return None
    return (
        f"{name}: {_percent(filled / known.size)} of the pixels with depth have exactly the "
        f"farthest depth, {farthest_m:.4g} m: probably these are holes that were filled, and they "
        "count as measured: write 0 or NaN where nothing was measured"
    )


def _percent(share: float) -> str:
    """Format a share as a percentage, with two decimals below 1 %."""
    return f"{share:.0%}" if share >= 0.01 else f"{share:.2%}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneShares:
    """Shares of pixels on the largest plane of each map, if depth is z and if it is ray length."""

    as_z: float
    as_length: float

    @property
    def lengths(self) -> bool | None:
        """Whether the depth is ray length; None if the shares do not decide this."""
        if max(self.as_z, self.as_length) < _PLANE_SHARE:
            return None
        if self.as_length > _TIMES * self.as_z:
            return True
        return False if self.as_z > _TIMES * self.as_length else None


def plane_shares(depths_m: Sequence[AnyDepth], optics: Optics) -> PlaneShares:
    """Return the shares of pixels on planes if depth is z and if depth is ray length.

    In most pictures, the largest plane is a floor or a table. If depth is read as the wrong kind,
    this plane becomes a bowl: at 30 degrees from the axis, a ray is 15 % longer than its z. On a
    plane, the reciprocal of z is linear over the picture: `1 / z = a x + b y + c`.

    Leaves out: pictures without a plane, and narrow fields of view with much noise, decide nothing.

    Args:
        depths_m: maps of z or ray length [m] from the camera `optics`; NaN where depth is missing.
    """
    rng = np.random.default_rng(0)  # The result hardly depends on which pixels are sampled.
    ray = picture_rays(optics).reshape(-1, 3)
    length = np.linalg.norm(ray, axis=1)
    on_plane, known_px = np.zeros(2), 0
    for depth_m in depths_m:
        known = np.flatnonzero(np.isfinite(depth_m))
        if known.size < _LEAST_PX:
            continue
        pixel = rng.choice(known, min(known.size, _PIXELS), replace=False)
        value = 1 / depth_m.ravel()[pixel].astype(np.float64)
        on_plane += [_on_plane(ray[pixel], value * k, rng) for k in (1.0, length[pixel])]
        known_px += pixel.size
    as_z, as_length = (on_plane / max(known_px, 1)).tolist()
    return PlaneShares(as_z=as_z, as_length=as_length)


def _on_plane(
    ray: Float[np.ndarray, "n 3"], inverse: Float[np.ndarray, " n"], rng: np.random.Generator
) -> int:
    """Return the largest number of pixels on one plane (RANSAC); `inverse` is 1 / z [1/m]."""
    three = rng.integers(0, len(ray), (_PLANES, 3))
    corners = ray[three]
    planes = np.flatnonzero(np.abs(np.linalg.det(corners)) > 1e-6)
    plane = np.linalg.solve(corners[planes], inverse[three[planes]][..., None])[..., 0]
    near = np.abs(ray @ plane.T / inverse[:, None] - 1) < _OFF
    best = near[:, near.sum(axis=0).argmax()]
    fit = np.linalg.lstsq(ray[best], inverse[best], rcond=None)[0]
    return max(int(best.sum()), int((np.abs(ray @ fit / inverse - 1) < _OFF).sum()))


def depth_kind_note(shares: PlaneShares, *, ray_length: bool) -> str | None:
    """Return a warning if ray length seems to be read as z, or z as ray length; else None."""
    if shares.lengths is None or shares.lengths is ray_length:
        return None
    z, length = f"{shares.as_z:.0%}", f"{shares.as_length:.0%}"
    if shares.lengths:
        return (
            f"the depth seems to be the length of each ray and not z: taken as lengths, {length} "
            f"of the pixels lie on one plane of their picture, taken as z {z}: if the camera "
            "measures so, give --ray-length"
        )
    return (
        f"the depth seems to be z and not the length of each ray: taken as z, {z} of the pixels "
        f"lie on one plane of their picture, taken as lengths {length}: leave out --ray-length"
    )
