"""Final alignment of a pose, which fits the part's surface and outline to the measurement."""

import math

import numpy as np

from ...base.kernels import kernel
from .closest import add_row, fill_row, solved, turn_by
from .drawing import draw

REACH_PX = 4.0  # The search for a measured outline extends this far from the predicted outline.
LINE_STEP_PX = 0.5


@kernel(nogil=True, error_model="numpy")
def align(T, part, window, gates_m, edge_m, canvas):
    """Improve a pose in place by Gauss-Newton steps, one for each gate (largest distance in z).

    The steps fit each measured point to the plane of the rendered face at its pixel, and the
    measured outline to the rendered outline along the outline's normal. A pixel of the outline has
    the same weight as a pixel of the surface. Source of the outline's equations: C. Harris, C.
    Stennett, "RAPID: a video rate object tracker", 1990.
    """
    for gate in gates_m:
        draw(T, part, window, canvas)
        A, b = np.zeros((6, 6)), np.zeros(6)
        surface = _surface_rows(A, b, T, part.normal, window, gate, canvas)
        _outline_rows(A, b, T, window, edge_m, canvas.depth)
        if surface < 6:
            return
        turn_by(T, solved(A, b))


@kernel(nogil=True, error_model="numpy")
def _surface_rows(A, b, T, face_normal, window, gate, canvas):
    z, ray, depth = window.z, window.ray, canvas.depth
    h, w = z.shape
    row, p, q = np.empty(6), np.empty(3), np.empty(3)
    count = 0
    for i in range(h):
        for j in range(w):
            off_z = z[i, j] - depth[i, j]
            if not abs(off_z) < gate or (window.tight and not window.inside[i, j]):
                continue
            _into_part(T, ray[i, j, 0], ray[i, j, 1], z[i, j], p)
            _into_part(T, ray[i, j, 0], ray[i, j, 1], depth[i, j], q)
            m = face_normal[canvas.face[i, j]]
            off = m[0] * (p[0] - q[0]) + m[1] * (p[1] - q[1]) + m[2] * (p[2] - q[2])
            fill_row(row, q, m[0], m[1], m[2])
            add_row(A, b, row, off, (1 - (off_z / gate) ** 2) ** 2)
            count += 1
    return count


@kernel(nogil=True, error_model="numpy")
def _outline_rows(A, b, T, window, edge_m, depth):
    lens, ray = window.lens, window.ray
    h, w = depth.shape
    row, p = np.empty(6), np.empty(3)
    f = math.sqrt(lens[0] * lens[1])
    for i in range(2, h - 2):
        for j in range(2, w - 2):
            zc = depth[i, j]
            if not zc < np.inf or not _on_outline(depth, i, j):
                continue
            nx, ny = _outwards(depth, i, j)
            if nx == 0 and ny == 0:
                continue
            here = _end(depth, i, j, nx, ny)
            off_px = _measured_end(window, i, j, nx, ny, zc, edge_m, here) - here
            if not abs(off_px) < REACH_PX:
                continue
            gx, gy = nx * lens[0] / f, ny * lens[1] / f
            gz = -(gx * ray[i, j, 0] + gy * ray[i, j, 1])
            _into_part(T, ray[i, j, 0], ray[i, j, 1], zc, p)
            mx = T[0, 0] * gx + T[1, 0] * gy + T[2, 0] * gz
            my = T[0, 1] * gx + T[1, 1] * gy + T[2, 1] * gz
            mz = T[0, 2] * gx + T[1, 2] * gy + T[2, 2] * gz
            fill_row(row, p, mx, my, mz)
            add_row(A, b, row, off_px * zc / f, (1 - (off_px / REACH_PX) ** 2) ** 2)


@kernel(nogil=True, error_model="numpy")
def _into_part(T, x, y, z, p):
    dx, dy, dz = x * z - T[0, 3], y * z - T[1, 3], z - T[2, 3]
    for j in range(3):
        p[j] = T[0, j] * dx + T[1, j] * dy + T[2, j] * dz


@kernel(nogil=True, error_model="numpy")
def _on_outline(depth, i, j):
    return (
        depth[i - 1, j] == np.inf
        or depth[i + 1, j] == np.inf
        or depth[i, j - 1] == np.inf
        or depth[i, j + 1] == np.inf
    )


@kernel(nogil=True, error_model="numpy")
def _outwards(depth, i, j):
    """Return the outline's outward normal in the image, from a window of 5 x 5 pixels."""
    x, y = 0.0, 0.0
    for di in range(-2, 3):
        for dj in range(-2, 3):
            if depth[i + di, j + dj] < np.inf:
                x -= dj
                y -= di
    length = math.sqrt(x * x + y * y)
    if length < 1:
        return 0.0, 0.0
    return x / length, y / length


@kernel(nogil=True, error_model="numpy")
def _end(depth, i, j, nx, ny):
    """Return the position along the normal at which the rendered part ends, in pixels."""
    s = 0.0
    while s < 3:
        r, c = round(i + s * ny), round(j + s * nx)
        if r < 0 or c < 0 or r >= depth.shape[0] or c >= depth.shape[1]:
            break
        if depth[r, c] == np.inf:
            break
        s += LINE_STEP_PX
    return s - LINE_STEP_PX / 2


@kernel(nogil=True, error_model="numpy")
def _measured_end(window, i, j, nx, ny, zc, edge_m, near):
    """Return the measured part's end along a normal, the one nearest to `near`; NaN if none.

    Edges of surfaces in front of the part do not count.
    """
    z, inside, tight = window.z, window.inside, window.tight
    best, before = np.nan, -1
    s = near - REACH_PX - LINE_STEP_PX
    while s < near + REACH_PX + LINE_STEP_PX:
        r, c = round(i + s * ny), round(j + s * nx)
        state = -1
        if 0 <= r < z.shape[0] and 0 <= c < z.shape[1]:
            if tight:
                if inside[r, c]:
                    state = 1
                elif not z[r, c] < zc - edge_m:
                    state = 0
            elif abs(z[r, c] - zc) <= edge_m:
                state = 1
            elif z[r, c] > zc:
                state = 0
        if before == 1 and state == 0:
            at = s - LINE_STEP_PX / 2
            if not abs(best - near) <= abs(at - near):
                best = at
        before = state
        s += LINE_STEP_PX
    return best
