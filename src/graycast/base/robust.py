"""Standard deviations that outliers do not spoil."""

from typing import Any

import numpy as np
from jaxtyping import Float

MAD_SIGMA = 1.4826  # It is a normal law's standard deviation over its median absolute deviation.


def robust_sigma(
    values: Float[np.ndarray, "..."],
    axis: int | tuple[int, ...] | None = None,
    *,
    keepdims: bool = False,
) -> Any:
    """The standard deviation about 0 of the normal law whose |values| have the same median.

    Along some axes, or of all values; NaN are left out, and no values have NaN.
    """
    if axis is None and not values.size:
        return float("nan")
    return MAD_SIGMA * np.nanmedian(np.abs(values), axis=axis, keepdims=keepdims)
