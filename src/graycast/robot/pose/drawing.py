"""Fast rendering of a closed mesh in a window of an image: depth and face at each pixel."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.kernels import kernel
from ...rig.optics import Optics


class Facets(NamedTuple):
    """A closed mesh in the part's frame."""

    vertex: Float[np.ndarray, "v 3"]
    face: Int[np.ndarray, "f 3"]
    normal: Float[np.ndarray, "f 3"]


class Window(NamedTuple):
    """The data of a detection's `Crop` for compiled code; `lens` has the camera's parameters."""

    lens: Float[np.ndarray, "9"]
    ray: Float[np.ndarray, "h w 2"]
    left_px: int
    top_px: int
    z: Float[np.ndarray, "h w"]
    inside: Bool[np.ndarray, "h w"]
    tight: bool


class Canvas(NamedTuple):
    """Depth and face index at each pixel of a window; empty pixels have infinity and -1."""

    depth: Float[np.ndarray, "h w"]
    face: Int[np.ndarray, "h w"]


def lens(camera: Optics) -> np.ndarray:
    """Return a camera's parameters for compiled code: fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    focal = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    return np.array([*focal, *camera.distortion], dtype=np.float64)


@kernel(nogil=True, error_model="numpy")
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel(nogil=True, error_model="numpy")
def draw(T, part, window, canvas):
    """Fill a canvas with the depth and index of the face that each pixel's ray meets.

    Faces that point away are skipped, because the mesh is closed. Faces that reach behind the lens
    are skipped as well. The equation is the same as in `graycast.rig.meshdepth`, in one pass.
    """
    lens, ray, vertex, faces = window.lens, window.ray, part.vertex, part.face
    z, face = canvas.depth, canvas.face
    h, w = z.shape
    z[:], face[:] = np.inf, -1
    n = len(vertex)
    cam, pixel = np.empty((n, 3)), np.empty((n, 2))
    for i in range(n):
        for j in range(3):
            cam[i, j] = (
                T[j, 0] * vertex[i, 0] + T[j, 1] * vertex[i, 1] + T[j, 2] * vertex[i, 2] + T[j, 3]
            )
        x, y = cam[i, 0] / cam[i, 2], cam[i, 1] / cam[i, 2]
        r2 = x * x + y * y
        radial = 1 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        u = x * radial + 2 * lens[6] * x * y + lens[7] * (r2 + 2 * x * x)
        v = y * radial + lens[6] * (r2 + 2 * y * y) + 2 * lens[7] * x * y
        pixel[i, 0] = u * lens[0] + lens[2] - window.left_px
        pixel[i, 1] = v * lens[1] + lens[3] - window.top_px
    bent = 0.01
    if lens[4] != 0 or lens[5] != 0 or lens[6] != 0 or lens[7] != 0 or lens[8] != 0:
        bent = 1.0  # Distortion bends straight edges slightly, so the search box gets a margin.
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        a, b, c = cam[i], cam[j], cam[k]
        if a[2] <= 0 or b[2] <= 0 or c[2] <= 0:
            continue
        # The edge functions are the ray's products with b x c, c x a and a x b.
        e0x, e0y, e0z = _cross(b, c)
        volume = a[0] * e0x + a[1] * e0y + a[2] * e0z
        if volume >= 0:
            continue  # The triangle faces away from the camera.
        e1x, e1y, e1z = _cross(c, a)
        e2x, e2y, e2z = _cross(a, b)
        low_x = min(pixel[i, 0], pixel[j, 0], pixel[k, 0]) - bent
        high_x = max(pixel[i, 0], pixel[j, 0], pixel[k, 0]) + bent
        low_y = min(pixel[i, 1], pixel[j, 1], pixel[k, 1]) - bent
        high_y = max(pixel[i, 1], pixel[j, 1], pixel[k, 1]) + bent
        for r in range(max(math.ceil(low_y), 0), min(math.floor(high_y), h - 1) + 1):
            for s in range(max(math.ceil(low_x), 0), min(math.floor(high_x), w - 1) + 1):
                x, y = ray[r, s, 0], ray[r, s, 1]
                first = e0x * x + e0y * y + e0z
                second = e1x * x + e1y * y + e1z
                third = e2x * x + e2y * y + e2z
                if first <= 0 and second <= 0 and third <= 0:
                    total = first + second + third
                    if total < 0 and volume / total < z[r, s]:
                        z[r, s], face[r, s] = volume / total, f
