"""Compute the depth of a mesh at pixel centres, to check renderers; it shares no code with them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..base.frames import inverse, transform_points
from ..base.kernels import kernel
from ..base.mask_box import overlap
from .optics import Optics, project, rays


@dataclass(frozen=True, slots=True, kw_only=True)
class Raster:
    """The nearest surface at each pixel of a rectangle, whose first pixel is (left_px, top_px).

    `z` is its depth, or NaN without a surface; `face` is the index of its face, or -1.
    """

    left_px: int
    top_px: int
    z: Float[np.ndarray, "bh bw"]
    face: Int[np.ndarray, "bh bw"]

    def __post_init__(self) -> None:
        self.z.flags.writeable = False
        self.face.flags.writeable = False

    def over(self, camera: Optics) -> tuple[Int[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """Return `face` and `z` for exactly the pixels of the camera's image."""
        face = np.full((camera.height_px, camera.width_px), -1)
        z = np.full(face.shape, np.nan)
        image, own = overlap(self.top_px, self.left_px, self.z.shape, face.shape)
        face[image], z[image] = self.face[own], self.z[own]
        return face, z


NOTHING = Raster(left_px=0, top_px=0, z=np.zeros((0, 0)), face=np.zeros((0, 0), dtype=np.int64))


def visible_surface(
    T_world_cam: Float[np.ndarray, "4 4"],
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    camera: Optics,
) -> tuple[Int[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return the face and the z-depth [m] at each pixel, for a mesh in world coordinates."""
    vertices_cam = transform_points(inverse(T_world_cam), vertices_m)
    return rasterize(vertices_cam, faces, camera).over(camera)


def rasterize(
    vertices_cam: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], camera: Optics
) -> Raster:
    """Return the nearest face at each pixel centre, for a mesh in the camera frame.

    Both sides of a face count. Without lens distortion the raster extends up to one image size
    beyond each border; with distortion it ends at the image. Triangles that reach behind the
    camera are left out. z has the unit of the vertices.

    For ray d and triangle a, b, c the edge functions d.(b x c), d.(c x a), d.(a x b) have the
    same sign inside, and z is a.(b x c) divided by their sum, because d has unit z.
    Source: J. Pineda, "A parallel algorithm for polygon rasterization", 1988; here in 3D.
    """
    number = np.flatnonzero((vertices_cam[:, 2] > 0)[faces].all(axis=1))
    corner = vertices_cam[faces[number]]
    if len(corner) == 0:
        return NOTHING
    one, two, three = project(camera, vertices_cam)[faces[number].T]
    low = np.minimum(np.minimum(one, two), three)
    high = np.maximum(np.maximum(one, two), three)
    # Distortion bends a straight edge, but by far less than a tenth of its length.
    margin = 0.01 + (2 + 0.1 * (high - low) if camera.has_distortion else 0.0)
    beyond = 0 if camera.has_distortion else 1
    size = np.array([camera.width_px, camera.height_px])
    first = np.maximum(np.ceil(low - margin), -beyond * size).astype(np.int64)
    last = np.minimum(np.floor(high + margin), (1 + beyond) * size - 1).astype(np.int64)
    met = (first <= last).all(axis=1)
    if not met.any():
        return NOTHING
    number, corner, first, last = number[met], corner[met], first[met], last[met]
    origin, end = first.min(axis=0), last.max(axis=0) + 1
    y, x = np.mgrid[origin[1] : end[1], origin[0] : end[0]].astype(np.float64)
    ray = rays(camera, np.stack([x, y], axis=-1))
    z, face = np.full(ray.shape[:2], np.inf), np.full(ray.shape[:2], -1)
    _nearest(corner, number, first - origin, last - origin, ray, z, face)
    z[np.isinf(z)] = np.nan
    return Raster(left_px=int(origin[0]), top_px=int(origin[1]), z=z, face=face)


@kernel()
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel()
def _nearest(corner, number, first, last, ray, z, face):
    for f in range(len(corner)):
        a, b, c = corner[f, 0], corner[f, 1], corner[f, 2]
        n0, n1, n2 = _cross(b, c), _cross(c, a), _cross(a, b)
        volume = a[0] * n0[0] + a[2] * n0[2] + a[1] * n0[1]
        for i in range(first[f, 1], last[f, 1] + 1):
            for j in range(first[f, 0], last[f, 0] + 1):
                x, y = ray[i, j, 0], ray[i, j, 1]
                e0 = n0[0] * x + n0[1] * y + n0[2]
                e1 = n1[0] * x + n1[1] * y + n1[2]
                e2 = n2[0] * x + n2[1] * y + n2[2]
                inside = (e0 >= 0 and e1 >= 0 and e2 >= 0) or (e0 <= 0 and e1 <= 0 and e2 <= 0)
                total = e0 + e1 + e2
                if inside and total != 0 and volume / total < z[i, j]:
                    z[i, j] = volume / total
                    face[i, j] = number[f]
