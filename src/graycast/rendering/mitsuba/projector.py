"""The projector as a light in Dr.Jit: its light at a point, and its rays to shiny surfaces."""

from collections.abc import Sequence

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np

from ...base.frames import inverse
from ...world.scene import Scene
from .lens import camera_ray, corner_share, picture_place, pixels_per_sr
from .patterns import aligned

CELL_PX = 8  # The projector's picture is divided into square cells of this side.
PATHS_EACH = 0.2  # The number of paths from the projector per path from the camera.
PROBES = 3  # Rows and columns of rays through a cell that search for a shiny surface.
TWO32 = 4294967296.0
R2_STEPS = 3242174889, 2447445414  # Steps of M. Roberts' R2 sequence, in units of 2^-32


class ProjectorLight:
    """Position and intensity of a scene's projector."""

    def __init__(self, scene: Scene):
        T_world_proj = scene.T_world_cam @ scene.rig.T_cam_proj
        self.optics = scene.rig.projector
        self.intensity_w_sr = scene.rig.intensity_w_sr
        self.lens = mi.Point3f(T_world_proj[:3, 3])
        self.R_world_proj = mi.Matrix3f(T_world_proj[:3, :3])
        self.R_proj_world = mi.Matrix3f(T_world_proj[:3, :3].T)
        self.T_proj_world = mi.Matrix4f(inverse(T_world_proj))

    def in_own_frame(self, p: mi.Point3f) -> mi.Point3f:
        q = self.T_proj_world @ mi.Vector4f(p.x, p.y, p.z, 1)
        return mi.Point3f(q.x, q.y, q.z)

    def on_lens(self, place: mi.Point2f) -> mi.Point3f:
        """Return a point of the lens in world coordinates; `place` is on the unit disc."""
        place = 0.5 * self.optics.aperture_m * place
        return mi.Point3f(self.lens + self.R_world_proj @ mi.Vector3f(place.x, place.y, 0))

    def intensity(self, q: mi.Point3f, place: mi.Point2f) -> mi.Float:
        """Return white's intensity towards a point `q` (own frame), seen at `place` [W sr^-1]."""
        intensity = mi.Float(self.intensity_w_sr)
        if self.optics.natural_vignetting:
            intensity *= q.z * dr.rsqrt(dr.squared_norm(q))
        if self.optics.falloff:
            intensity *= 1 - self.optics.falloff * corner_share(self.optics, place)
        return intensity


class ShinyField:
    """The cells of the projector's picture that light a shiny surface, and rays through them.

    A cell is used if one of its probes, or of its neighbours' probes, finds a shiny surface. Light
    through other cells is sampled only by paths from the camera.
    """

    def __init__(
        self, world: mi.Scene, light: ProjectorLight, shapes: Sequence[mi.Shape], pixels: int
    ):
        self.light = light
        self.paths = max(1, round(PATHS_EACH * pixels))  # paths for one sample in every pixel
        number = [_number(mi.ShapePtr(shape)).numpy()[0] for shape in shapes]
        shiny = np.zeros(max(number) + 1, dtype=np.uint32)
        shiny[number] = 1
        # Opaque, because literals would force a new compilation of the kernel for every scene.
        self._shiny, self._most = mi.UInt32(aligned(shiny)), dr.opaque(mi.UInt32, len(shiny) - 1)
        # A border of one cell, because the picture is larger if the lens is out of focus.
        self.columns = -(-light.optics.width_px // CELL_PX) + 2
        self.rows = -(-light.optics.height_px // CELL_PX) + 2
        cells = self._find_cells(world)
        self.count = len(cells)
        density = np.zeros(self.rows * self.columns, dtype=np.float32)
        density[cells] = 1 / (max(self.count, 1) * CELL_PX**2)
        self._cells, self._density = mi.UInt32(aligned(cells)), mi.Float(aligned(density))

    def has(self, si: mi.SurfaceInteraction3f) -> mi.Bool:
        """Return whether a surface is shiny."""
        number = _number(si.shape)
        known = si.is_valid() & (number <= self._most)
        return known & (dr.gather(mi.UInt32, self._shiny, number, known) == 1)

    def places(self, index: mi.UInt64, total: int, start: mi.Point2u) -> mi.Point2f:
        """Return positions [px] by their indices among `total`, spread evenly over all cells.

        The positions inside a cell repeat after 2^32 indices.
        """
        of_all = index * dr.opaque(mi.UInt64, self.count)
        cell = mi.UInt32(of_all // dr.opaque(mi.UInt64, total))
        cell = dr.gather(mi.UInt32, self._cells, cell)
        number = mi.UInt32(index)  # The lower half of the bits
        x = mi.Float(number * R2_STEPS[0] + start.x) / TWO32
        y = mi.Float(number * R2_STEPS[1] + start.y) / TWO32
        column, row = mi.Float(cell % self.columns), mi.Float(cell // self.columns)
        return mi.Point2f(column - 1 + x, row - 1 + y) * CELL_PX - 0.5

    def direction(self, place: mi.Point2f) -> mi.Vector3f:
        """Return the world direction of rays for a position [px], from any point of the lens."""
        ray = camera_ray(self.light.optics, place.x, place.y)
        return mi.Vector3f(self.light.R_world_proj @ ray)

    def density(self, direction: mi.Vector3f) -> mi.Float:
        """Return the density of rays per direction [sr^-1]; 0 for directions without rays."""
        ray = mi.Vector3f(self.light.R_proj_world @ direction)
        place, _, ahead = picture_place(self.light.optics, ray)
        column = dr.floor((place.x + 0.5) / CELL_PX) + 1
        row = dr.floor((place.y + 0.5) / CELL_PX) + 1
        inside = ahead & (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        cell = mi.UInt32(dr.select(inside, row * self.columns + column, 0))
        density = dr.gather(mi.Float, self._density, cell, inside)
        return dr.select(density > 0, density * pixels_per_sr(self.light.optics, ray, ray), 0)

    def _find_cells(self, world: mi.Scene) -> np.ndarray:
        """Return the numbers of the cells with a shiny surface in them or in a neighbour."""
        at = (np.arange(PROBES) + 0.5) / PROBES
        x = ((np.arange(self.columns) - 1)[:, None] + at).ravel() * CELL_PX - 0.5
        y = ((np.arange(self.rows) - 1)[:, None] + at).ravel() * CELL_PX - 0.5
        grid = np.broadcast_arrays(x[None, :], y[:, None])
        place = mi.Point2f(*(mi.Float(aligned(axis.astype(np.float32))) for axis in grid))
        si = world.ray_intersect(mi.Ray3f(self.light.lens, self.direction(place)))
        hit = self.has(si).numpy().reshape(self.rows, PROBES, self.columns, PROBES)
        wide = cv2.dilate(hit.any(axis=(1, 3)).astype(np.uint8), np.ones((3, 3), np.uint8))
        return np.flatnonzero(wide).astype(np.uint32)


def share(odds: mi.Float) -> mi.Float:
    """Return the weight of a path that the other kind of path finds `odds` times as often."""
    finite = odds < 1e18  # Also rejects NaN: a mirror multiplies a huge density by zero.
    return dr.select(finite, dr.rcp(dr.fma(odds, odds, 1)), 0)


def odds_on_arrival(odds: mi.Float, si, direction: mi.Vector3f, first: mi.Bool) -> mi.Float:
    """Update the odds at a new vertex, where densities per area have the cosine as a factor.

    The squared distance matters only at the first vertex; elsewhere it is equal for both kinds.
    """
    cosine = dr.abs(dr.dot(si.n, direction))
    return odds * dr.select(first, dr.square(si.t), 1) / cosine


def odds_onward(
    odds: mi.Float, back_pdf: mi.Float, pdf: mi.Float, si, direction: mi.Vector3f, first: mi.Bool
) -> mi.Float:
    """Update the odds after a vertex by the ratio of the direction densities of both path kinds."""
    return odds * dr.select(first, 1, back_pdf) * dr.abs(dr.dot(si.n, direction)) / pdf


def back_pdf(bsdf, context, si, wo: mi.Vector3f) -> mi.Float:
    """Return the density of the reverse path, which comes from `wo` and leaves along `si.wi`."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wo
    return bsdf.pdf(context, other, si.wi, True)


def _number(shape: mi.ShapePtr) -> mi.UInt32:
    """Return the number by which Dr.Jit identifies a shape; 0 is no shape."""
    return dr.reinterpret_array(mi.UInt32, shape)
