"""The median of a few values, for use in kernels."""

import numpy as np

from ...base.kernels import kernel


@kernel()
def median(values, least):
    """Return the median of the values that are not NaN, or NaN if they are fewer than `least`.

    It uses an insertion sort, because numba takes two seconds to compile NumPy's median.
    """
    known = np.empty(len(values))
    count = 0
    for k in range(len(values)):
        value = values[k]
        if np.isnan(value):
            continue
        at = count
        while at > 0 and known[at - 1] > value:
            known[at] = known[at - 1]
            at -= 1
        known[at] = value
        count += 1
    if count < least:
        return np.nan
    middle = count // 2
    return known[middle] if count % 2 else 0.5 * (known[middle - 1] + known[middle])
