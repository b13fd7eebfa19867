"""Whether depth can be what it is given for: its unit against a known range, and filled holes."""

import numpy as np
from jaxtyping import Float, Float32

from ..base.errors import DatasetError

BEYOND = 1.5  # No place of the camera explains a median beyond far times this or near over this.
FILLED = 0.05  # A larger share of the known pixels at exactly the farthest depth may be a fill.
_FEWER = 5  # Far measured depth thins out; a fill has so many times the pixels of depths below.

AnyDepth = Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"]


def refuse_beyond(depth_m: AnyDepth, *, near_m: float, far_m: float, name: str, whose: str) -> None:
    """Refuse depth that lies far outside a known range, as with another unit.

    Args:
        depth_m: z [m]; NaN where there is none. A map without depth is not refused.
        whose: a clause that says what has the range, such as "the detector learnt".

    Raises:
        DatasetError: the median is beyond the range by half of its end, or more.
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
    """A sentence about holes that were filled with the farthest depth; None if there are none.

    Leaves out: a wall of one exact depth, which no scanner measures but a perfect picture may have.
    """
    known = depth_m[np.isfinite(depth_m)]
    if not known.size:
        return None
    value, count = np.unique(known, return_counts=True)
    farthest_m, filled = value[-1], int(count[-1])
    if filled < FILLED * known.size or filled < _FEWER * count[-4:-1].max(initial=0):
        return None
    return (
        f"{name}: {filled / known.size:.0%} of the pixels with depth have exactly the farthest "
        f"depth, {farthest_m:.4g} m: probably these are holes that were filled, and they count as "
        "measured: write 0 or NaN where nothing was measured"
    )
