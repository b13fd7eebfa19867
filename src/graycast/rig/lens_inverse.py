"""Compiled inverse of Brown-Conrady distortion, point by point."""

import numba

from ..base.kernels import kernel

ITERATIONS = 20  # Newton's method needs four or five where an inverse exists.
RESIDUAL = 1e-14  # Newton's method stops at this error in normalised image coordinates.


@kernel(parallel=True, error_model="numpy")
def undistort_in_place(xy, k1, k2, p1, p2, k3):
    """Undistort points in normalised image coordinates; return whether all points succeeded.

    `xy` has a row for each point; the first two numbers of a row are changed.
    """
    lost = 0
    for i in numba.prange(len(xy)):
        x, y, good = undistorted(xy[i, 0], xy[i, 1], (k1, k2, p1, p2, k3))
        lost += not good
        xy[i, 0], xy[i, 1] = x, y
    return lost == 0


@kernel(error_model="numpy")
def undistorted(goal_x, goal_y, distortion):
    """Return the ideal point for a distorted point, and whether such a point exists."""
    k1, k2, p1, p2, k3 = distortion
    x, y = goal_x, goal_y
    for _ in range(ITERATIONS):
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # d radial / d r2, times 2
        a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
        b = slope * x * y + 2 * p1 * x + 2 * p2 * y
        d = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
        error_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - goal_x
        error_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - goal_y
        determinant = a * d - b * b
        if abs(error_x) < RESIDUAL and abs(error_y) < RESIDUAL:
            break
        x -= (d * error_x - b * error_y) / determinant
        y -= (a * error_y - b * error_x) / determinant
    # NaN must fail too. Where the distortion folds over, the determinant is not positive.
    return x, y, abs(error_x) < 1e-9 and abs(error_y) < 1e-9 and determinant > 0
