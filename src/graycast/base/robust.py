"""Standard deviations that outliers do not spoil."""

from typing import Any

import numpy as np
from jaxtyping import Float

MAD_SIGMA = 1.4826  # standard deviation over median absolute deviation of a normal distribution


def robust_sigma(
    values: Float[np.ndarray, "..."],
    axis: int | tuple[int, ...] | None = None,
    *,
    keepdims: bool = False,
) -> Any:
    """Return the standard deviation of the zero-mean normal law with the values' median |value|.

    It is taken along some axes, or over all values. NaN values are left out; the result is NaN
    if no value is left.
    """
    if axis is None and not values.size:
        return float("nan")
    return MAD_SIGMA * np.nanmedian(np.abs(values), axis=axis, keepdims=keepdims)
