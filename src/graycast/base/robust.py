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
    """Return the standard deviation of the zero-mean normal law with the values' median |value|.

    It is computed along the given axes, or over all values. NaN values are ignored; the result is
    NaN if all values are NaN.
    """
    if axis is None and not values.size:
        return float("nan")
    return MAD_SIGMA * np.nanmedian(np.abs(values), axis=axis, keepdims=keepdims)
