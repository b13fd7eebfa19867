"""Intersect rays with scenes that may have glass: rays pass thin walls and meet solid glass.

A ray either passes a thin wall, with the transmitted share as the probability, or ends there and is
mirrored. So a wall that is passed is no vertex, and surfaces behind it are lit and seen directly.
For shadow rays, the share of each wall is a factor.

Glass has delta distributions, at which paths cannot be connected (E. Veach 1997, section 10.3.5).
So light whose first surface is glass is found only from the projector, and surfaces behind glass
only from the camera. Such paths have full weight, with odds of 0 from there on. Between two other
vertices, both kinds of path sample a delta vertex with the same probability, because Fresnel's
equations hold for both directions, and cosines cancel, so the odds do not change. Both leave out
the square of the index and the share of thin walls, so the weights of a path still add up to 1.

A delta vertex counts neither for the depth of a path nor as its first vertex: after it, a path
from the camera continues as if it had just started.
"""

import drjit as dr
import mitsuba as mi

from ..bsdf.dielectric import Dielectric, ThinDielectric

OFFSET_M = 2e-5  # Start of rays from glass; Mitsuba's 2e-4 is a tenth of the wall of a bottle.
DELTA_PDF = 1e15  # A finite substitute for infinity, with which weights would be NaN.
MOST_GLASS = 32  # A path ends after this many passages through solid glass.


class Sight:
    """Rays through a world; without thin walls they are ordinary rays."""

    def __init__(self, world: mi.Scene, *, glass: bool, thin: bool):
        self.world, self.glass, self.thin = world, glass, thin

    def first(
        self, ray: mi.Ray3f, color: mi.Color3f, rng: mi.PCG32, *, straight: bool = False
    ) -> tuple[mi.SurfaceInteraction3f, mi.Color3f, mi.PCG32]:
        """Return the surface at which a ray ends, its `color` after thin walls, and `rng`.

        The length `t` is from the start of the ray. A `straight` ray passes all thin walls.
        """
        si = self.world.ray_intersect(ray)
        if not self.thin:
            return si, color, rng
        state = (si, mi.Float(0), mi.Color3f(color), mi.PCG32(rng), si.is_valid())

        def passed(si, length, color, rng, going):
            share, own = dr.dispatch(si.bsdf(), _passing, si)
            going &= share > 0 if straight else rng.next_float32() < share
            color = dr.select(going, color * own, color)
            length = dr.select(going, length + si.t, length)
            behind = self.world.ray_intersect(mi.Ray3f(_beside(si, ray.d), ray.d), going)
            si = dr.select(going, behind, si)
            return si, length, color, rng, going & si.is_valid()

        si, length, color, rng, _ = dr.while_loop(
            state=state, cond=lambda si, length, color, rng, going: going, body=passed
        )
        si.t += length
        return si, color, rng

    def centre(self, ray: mi.Ray3f) -> tuple[mi.SurfaceInteraction3f, mi.Bool]:
        """Return the first surface of a ray behind thin walls, and whether it is solid glass."""
        if not self.glass:
            si = self.world.ray_intersect(ray, mi.RayFlags.Minimal, coherent=True)
            return si, mi.Bool(False)
        si, _, _ = self.first(ray, mi.Color3f(1), mi.PCG32(size=dr.width(ray)), straight=True)
        return si, dr.dispatch(si.bsdf(), _is_solid, si)

    def reaches(
        self, si: mi.SurfaceInteraction3f, target: mi.Point3f, lit: mi.Bool
    ) -> tuple[mi.Bool, mi.Color3f]:
        """Return whether light from a point reaches a surface, and the share after thin walls."""
        ray = si.spawn_ray_to(target)
        if not self.thin:
            return lit & ~self.world.ray_test(ray, lit), mi.Color3f(1)

        def passed(ray, share, going):
            hit = self.world.ray_intersect(ray, going)
            going &= hit.is_valid()
            passing, own = dr.dispatch(hit.bsdf(), _passing, hit)
            share = dr.select(going, share * own * passing, share)
            going &= dr.max(share) > 0
            return dr.select(going, hit.spawn_ray_to(target), ray), share, going

        _, share, _ = dr.while_loop(
            state=(ray, mi.Color3f(1), mi.Bool(lit)),
            cond=lambda ray, share, going: going,
            body=passed,
        )
        return lit & (dr.max(share) > 0), share

    def is_delta(self, bs: mi.BSDFSample3f) -> mi.Bool:
        """Return whether a sampled direction comes from glass."""
        return mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) if self.glass else mi.Bool(False)

    def onward(self, si: mi.SurfaceInteraction3f, bs: mi.BSDFSample3f) -> mi.Ray3f:
        """Return the next ray of a path."""
        ray = si.spawn_ray(si.to_world(bs.wo))
        ray.o = dr.select(self.is_delta(bs), _beside(si, ray.d), ray.o)
        return ray

    def lamp(
        self, si: mi.SurfaceInteraction3f, uv: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Color3f]:
        """Sample a direction to a lamp or the environment; return it, and radiance over density."""
        ds, radiance = self.world.sample_emitter_direction(si, uv, not self.thin, active)
        if self.thin:
            lit, share = self.reaches(si, ds.p, active & (ds.pdf > 0))
            radiance = dr.select(lit, radiance * share, 0)
        return ds, radiance


def counted(passed: mi.UInt32, alive: mi.Bool, delta: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
    """Update the number of a path's passages through glass, and end the path after too many."""
    passed = passed + dr.select(delta, mi.UInt32(1), 0)
    return passed, alive & (passed < MOST_GLASS)


def _beside(si: mi.SurfaceInteraction3f, direction: mi.Vector3f) -> mi.Point3f:
    aside = dr.mulsign(OFFSET_M * mi.Vector3f(si.n), dr.dot(si.n, direction))
    return mi.Point3f(si.p + aside)


def _is_solid(bsdf, si) -> mi.Bool:
    return mi.Bool(isinstance(bsdf, Dielectric))


def _passing(bsdf, si) -> tuple[mi.Float, mi.Color3f]:
    if isinstance(bsdf, ThinDielectric):
        return bsdf.passing(si)
    return mi.Float(0), mi.Color3f(0)
