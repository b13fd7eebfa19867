"""Standard deviations on which outliers have little influence."""

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
    """Estimate the standard deviation of normally distributed values with mean zero.

    The estimate is 1.4826 times the median of |value|, along the given axes or over all values. NaN
    values are ignored; the result is NaN if all values are NaN.
    """
    if axis is None and not values.size:
        return float("nan")
    return MAD_SIGMA * np.nanmedian(np.abs(values), axis=axis, keepdims=keepdims)
