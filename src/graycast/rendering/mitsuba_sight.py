"""What rays meet where there may be glass: thin walls are passed on the way, solid glass is met.

A ray passes a thin wall with the probability of the share that goes straight on, or ends at it, to
be mirrored. So a wall that is passed is no vertex, and what is behind is lit and seen directly.
Shadow rays take each wall's share as a factor.

Glass has delta distributions, at which no path is connected (E. Veach 1997, section 10.3.5). So
light whose first surface is glass is found from the projector alone, and what is seen by glass from
the camera alone: each counts in full, with odds of 0 from there on. Between two other vertices both
kinds of path take the delta vertex with the same probability, for Fresnel's is that of both sides,
and its cosines cancel: the odds stay as they were. Both leave out the square of the index that
refraction adds, and the share of thin walls, so that the weights of a path still add up to 1.

A delta vertex counts neither for the depth of a path nor as its first vertex: a path from the
camera goes on as if it had just started.
"""

import drjit as dr
import mitsuba as mi

from .dielectric import Dielectric, ThinDielectric

OFFSET_M = 2e-5  # Rays start so far from glass; Mitsuba's 2e-4 is a tenth of a bottle's wall.
DELTA_PDF = 1e15  # It stands for infinity, whose square is no number.
MOST_GLASS = 32  # A path ends that solid glass has sent on so often.


class Sight:
    """Rays through a world; without thin walls they are plain rays."""

    def __init__(self, world: mi.Scene, *, glass: bool, thin: bool):
        self.world, self.glass, self.thin = world, glass, thin

    def first(
        self, ray: mi.Ray3f, color: mi.Color3f, rng: mi.PCG32, *, straight: bool = False
    ) -> tuple[mi.SurfaceInteraction3f, mi.Color3f, mi.PCG32]:
        """The surface at which a ray ends, its `color` behind the walls on the way, and `rng`.

        The length `t` is that from the start of the ray. A `straight` ray ends at no thin wall.
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
        """The surface that a ray meets behind thin walls, and whether it is solid glass."""
        if not self.glass:
            si = self.world.ray_intersect(ray, mi.RayFlags.Minimal, coherent=True)
            return si, mi.Bool(False)
        si, _, _ = self.first(ray, mi.Color3f(1), mi.PCG32(size=dr.width(ray)), straight=True)
        return si, dr.dispatch(si.bsdf(), _is_solid, si)

    def reaches(
        self, si: mi.SurfaceInteraction3f, target: mi.Point3f, lit: mi.Bool
    ) -> tuple[mi.Bool, mi.Color3f]:
        """Whether light comes from a point to a surface, and the share that walls let through."""
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
        """Whether glass has chosen a direction."""
        return mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) if self.glass else mi.Bool(False)

    def onward(self, si: mi.SurfaceInteraction3f, bs: mi.BSDFSample3f) -> mi.Ray3f:
        """The ray of a path that goes on."""
        ray = si.spawn_ray(si.to_world(bs.wo))
        ray.o = dr.select(self.is_delta(bs), _beside(si, ray.d), ray.o)
        return ray

    def lamp(
        self, si: mi.SurfaceInteraction3f, uv: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Color3f]:
        """A direction to a lamp or the environment, and the radiance over its density."""
        ds, radiance = self.world.sample_emitter_direction(si, uv, not self.thin, active)
        if self.thin:
            lit, share = self.reaches(si, ds.p, active & (ds.pdf > 0))
            radiance = dr.select(lit, radiance * share, 0)
        return ds, radiance


def counted(passed: mi.UInt32, alive: mi.Bool, delta: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
    """How often glass has sent a path on, and whether it goes on."""
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
