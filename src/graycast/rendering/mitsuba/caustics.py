"""Light paths from the projector over shiny surfaces to the camera: caustics, for all patterns.

A path from the camera finds light from a polished face only if the random diffuse direction at the
lit surface happens to meet the spot that mirrors the small lens of the projector. This is rare, and
such a path is very bright. A path from the projector meets that spot directly. It starts at a
position in the projector's picture and carries the levels there. Each vertex from the second on is
connected to a point of the camera's pupil, and its light is added to that pixel unless occluded.

Both kinds of path can find most of this light, so each is weighted by multiple importance sampling
(`share`), with the odds that the other kind would have found the path. Direct light, and light
whose first surface is not shiny, is sampled only from the camera.

Both kinds integrate the same function: materials are evaluated with light and camera on the same
sides, and each bounce has the cosines to the true normal that its density lacks (Veach's factor for
interpolated normals). Out of focus, the position of a path in the projector's picture is a random
point of the disc over which paths from the camera use the mean.

The sums are 64-bit integers, so they do not depend on the order in which threads add. While the
paths run, they need 8 bytes for each pixel and each of the patterns, the three bands and the finest
pattern of each axis (docs/how-to/many-scenes.md).

Source: E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997: sections 5.3,
9.2 and 10.2 (bidirectional path tracing; this is t = 1, combined with s = 1).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ...rig.pattern import Axis
from .lens import blur_radius2, camera_place, on_pixel, picture_place, pixel_index, shines
from .projector import ShinyField, odds_on_arrival, odds_onward, share
from .sight import counted
from .stage import ROULETTE_FROM, Stage, survival

LANES = 2_500_000  # The largest number of paths that run in parallel.
UNIT = 2.0**-32  # Unit of the sums, relative to the light of white paper at one metre.
BRIGHTEST = 2.0**24 - 1  # Largest light, on the same scale, that one path adds to a pixel.
UNIT_SAMPLES = 256  # 64 bits hold this many times BRIGHTEST; more samples need a larger unit.


@dataclass(frozen=True, slots=True)
class Caustics:
    """The light that paths from the projector add to the sums of each pixel."""

    pattern: list[mi.Float]
    white: mi.Color3f
    stray2: Mapping[Axis, mi.Float]  # Variance of the finest pattern's sum


@dataclass
class _LightPaths:
    """The state of the loop, with one path per lane."""

    rng: mi.PCG32
    vertex: mi.UInt32
    alive: mi.Bool
    throughput: mi.Color3f
    origin: mi.Point3f
    direction: mi.Vector3f
    odds: mi.Float
    power: mi.Float  # Power at the start of the path, without `throughput`
    pixel: mi.UInt32  # Pixel of the projector's picture
    passed: mi.UInt32 | None  # Number of passages through solid glass; None without glass


class CausticTracer:
    """Paths from the projector over the shiny surfaces of a stage."""

    def __init__(self, stage: Stage, field: ShinyField):
        self.stage, self.field, self.sight = stage, field, stage.sight
        self.camera, self.projector = stage.camera, stage.light.optics
        self.power = mi.BSDFContext(mi.TransportMode.Importance)
        self.total = field.paths * stage.quality.samples
        self.stride = stage.patterns.count + 3 + len(stage.strays)
        self.step = sum_step(stage.quality.samples)
        self.unit = self.step * stage.light.intensity_w_sr / math.pi
        self.sums = dr.zeros(mi.UInt64, stage.pixels * self.stride)

    def trace(self, seed: int) -> Caustics:
        """Trace all paths, block by block, and return the light that they add."""
        starts = mi.PCG32(size=2, initstate=dr.opaque(mi.UInt64, seed)).next_uint32().numpy()
        start = mi.Point2u(*(dr.opaque(mi.UInt32, int(one)) for one in starts))
        for first, lanes in blocks(self.total):
            # A full picture with some thousands of samples has more than 2^32 paths.
            index = dr.arange(mi.UInt64, lanes) + dr.opaque(mi.UInt64, first)
            # These random numbers must differ from the numbers of the paths from the camera.
            state = dr.opaque(mi.UInt64, (seed * 0x9E3779B97F4A7C15 + first + 1) % 2**64)
            paths = self._started(mi.PCG32(size=lanes, initstate=state), index, start)
            (paths,) = dr.while_loop(
                state=(paths,), cond=lambda p: p.alive, body=lambda p: (self._vertex(p),)
            )
            dr.eval(self.sums, paths.alive)
        return self._result()

    def _started(self, rng: mi.PCG32, index: mi.UInt64, start: mi.Point2u) -> _LightPaths:
        """Start paths at the projector, and continue those whose first surface is shiny."""
        light = self.stage.light
        origin = light.on_lens(_on_disc(rng))
        direction = self.field.direction(self.field.places(index, self.total, start))
        density = self.field.density(direction)
        ray = mi.Ray3f(origin, direction)
        si, passing, rng = self.sight.first(ray, mi.Color3f(1), rng)
        q = light.in_own_frame(si.p)
        place, inverse_z, _ = picture_place(light.optics, q)
        pixel, shining = self._shining_pixel(rng, place, inverse_z)
        alive = self.field.has(si) & shining & (density > 0) & (si.wi.z > 0)
        power = light.intensity(q, place) / (density * self.field.paths)
        paths = _LightPaths(
            rng=rng,
            vertex=mi.UInt32(0),
            alive=alive,
            throughput=passing,
            origin=origin,
            direction=direction,
            odds=odds_on_arrival(dr.rcp(density), si, direction, mi.Bool(True)),
            power=power,
            pixel=pixel,
            passed=mi.UInt32(0) if self.sight.glass else None,
        )
        _, _, bs, value, pdf = self._dispatched(paths, si, si.wi)
        return self._go_on(paths, si, bs, value, pdf, None)

    def _shining_pixel(
        self, rng: mi.PCG32, place: mi.Point2f, inverse_z: mi.Float
    ) -> tuple[mi.UInt32, mi.Bool]:
        """Return the projector pixel for a path at `place`, and whether it emits light there."""
        optics = self.projector
        if not optics.is_pinhole:
            disc = _on_disc(rng) * dr.sqrt(blur_radius2(optics, inverse_z))
            x, y = place.x + disc.x * optics.fx_px, place.y + disc.y * optics.fy_px
            place = mi.Point2f(x, y)
        return pixel_index(optics, on_pixel(optics, place)), shines(optics, place)

    def _vertex(self, p: _LightPaths) -> _LightPaths:
        """Find the next vertex, add its light to the pixel that sees it, and sample a direction."""
        stage, camera = self.stage, self.camera
        ray = mi.Ray3f(p.origin, p.direction)
        si, p.throughput, p.rng = self.sight.first(ray, p.throughput, p.rng)
        hit = p.alive & si.is_valid()
        if not self.sight.glass:  # No path runs inside an opaque body.
            hit &= si.wi.z > 0
        before = p.odds
        p.odds = odds_on_arrival(p.odds, si, p.direction, mi.Bool(False))
        q = stage.T_cam_world @ mi.Vector4f(si.p.x, si.p.y, si.p.z, 1)
        place, ray, per_sr, ahead = camera_place(camera, mi.Point3f(q.x, q.y, q.z), _on_disc(p.rng))
        if camera.psf_px:
            place -= camera.psf_px * _on_disc(p.rng)
        to_camera = mi.Vector3f(stage.R_world_cam @ -ray)
        lens = mi.Point3f(si.p + to_camera)
        inverse_square = dr.rcp(dr.squared_norm(to_camera))
        to_camera *= dr.sqrt(inverse_square)
        wo = si.to_local(to_camera)
        value, pdf, bs, onward_value, onward_pdf = self._dispatched(p, si, wo)
        lit = hit & ahead & shines(camera, place) & (wo.z > 0)
        lit, passing = self.sight.reaches(si, lens, lit)
        value *= passing
        cosine = dr.abs(dr.dot(si.n, to_camera))
        # Normalise by the area of the pixel's active square, over which positions are spread.
        places = cosine * inverse_square * per_sr / camera.fill_factor
        odds = p.odds * pdf * places / self.field.paths
        weight = share(odds) * places / dr.abs(dr.dot(si.n, p.direction))
        light = p.power * p.throughput * value * weight * stage.weights
        self._add(p, pixel_index(camera, on_pixel(camera, place)), light, lit)
        delta = self.sight.is_delta(bs)
        p.vertex += dr.select(delta, mi.UInt32(0), 1)
        p.alive = hit & (delta | (p.vertex + 1 < stage.quality.depth))
        if p.passed is not None:
            p.passed, p.alive = counted(p.passed, p.alive, delta)
        return self._go_on(p, si, bs, onward_value, onward_pdf, before)

    def _dispatched(self, p: _LightPaths, si, to_camera: mi.Vector3f):
        pick = p.rng.next_float32()
        uv = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        ray = mi.Ray3f(p.origin, p.direction)
        return dr.dispatch(si.bsdf(ray), self._ask, si, to_camera, pick, uv)

    def _ask(self, bsdf, si, to_camera, pick, uv):
        """Evaluate the reflection from the camera to this path's origin, and sample a direction.

        Return value and density of the reflection; and the direction, its value and density.
        """
        if bsdf is None:  # The world has no surface.
            none = mi.Color3f(0)
            return none, mi.Float(0), dr.zeros(mi.BSDFSample3f), none, mi.Float(0)
        context = self.stage.context
        bs, gain = bsdf.sample(self.power, si, pick, uv, True)
        back, onward = mi.SurfaceInteraction3f(si), mi.SurfaceInteraction3f(si)
        back.wi, onward.wi = to_camera, bs.wo
        value, pdf = bsdf.eval_pdf(context, back, si.wi, True)
        onward_value, onward_pdf = bsdf.eval_pdf(context, onward, si.wi, True)
        # A delta reflection has a weight and no value.
        onward_value = dr.select(self.sight.is_delta(bs), gain, onward_value)
        return value, pdf, bs, onward_value, onward_pdf

    def _go_on(
        self, p: _LightPaths, si, bs, value: mi.Color3f, pdf: mi.Float, before: mi.Float | None
    ) -> _LightPaths:
        """Follow the sampled direction or end the path; `before` is None at the first vertex."""
        direction = si.to_world(bs.wo)
        cosines = dr.abs(dr.dot(si.n, direction)) / dr.abs(dr.dot(si.n, p.direction))
        delta = self.sight.is_delta(bs)
        alive = p.alive & (bs.pdf > 0) & (delta | (bs.wo.z > 0))
        factor = dr.select(delta, 1, cosines / bs.pdf)
        p.throughput = dr.select(alive, p.throughput * value * factor, 0)
        odds = odds_onward(p.odds, pdf, bs.pdf, si, direction, mi.Bool(before is None))
        p.odds = dr.select(delta, 0 if before is None else before, odds)
        share_left = survival(p.throughput, p.vertex + 1 >= ROULETTE_FROM)
        p.alive = alive & (p.rng.next_float32() < share_left)
        p.throughput = dr.select(p.alive, p.throughput / share_left, 0)
        onward = self.sight.onward(si, bs)
        p.origin, p.direction = onward.o, onward.d
        return p

    def _add(self, p: _LightPaths, pixel: mi.UInt32, light: mi.Color3f, lit: mi.Bool) -> None:
        """Add light to the sums of a camera pixel."""
        first = pixel * self.stride
        most = BRIGHTEST / self.step
        light = dr.minimum(dr.select(lit, light, 0) / self.unit, most)
        mono = dr.minimum(dr.sum(light), most)
        levels = self.stage.patterns.levels(p.pixel, lit)
        for k, level in enumerate(levels):
            dr.scatter_add(self.sums, mi.UInt64(mono * level), first + k, lit & (level > 0))
        first += len(levels)
        for k in range(3):
            dr.scatter_add(self.sums, mi.UInt64(light[k]), first + k, lit)
        first += 3
        for k, fine in enumerate(self.stage.strays.values()):
            off = (levels[fine.number] - fine.mean) * (mono * self.step / fine.deviation)
            squared = dr.minimum(dr.square(off), BRIGHTEST) / self.step
            dr.scatter_add(self.sums, mi.UInt64(squared), first + k, lit)

    def _result(self) -> Caustics:
        first = dr.arange(mi.UInt32, len(self.sums) // self.stride) * self.stride

        def sums(k: int, unit: float) -> mi.Float:
            return mi.Float(dr.gather(mi.UInt64, self.sums, first + k)) * unit

        n, unit = self.stage.patterns.count, self.unit
        square = unit**2 / self.step
        return Caustics(
            pattern=[sums(k, unit) for k in range(n)],
            white=mi.Color3f(*(sums(n + k, unit) for k in range(3))),
            stray2={axis: sums(n + 3 + k, square) for k, axis in enumerate(self.stage.strays)},
        )


def blocks(total: int) -> Iterator[tuple[int, int]]:
    """Yield the first path and the number of paths of each block that runs in parallel."""
    for first in range(0, total, LANES):
        yield first, min(LANES, total - first)


def sum_step(samples: int) -> float:
    """Return the unit of the sums for a number of samples, relative to white paper at one metre.

    It is `UNIT` for up to `UNIT_SAMPLES` samples, and a power of two times that for more, so that
    the sum of a pixel overflows 64 bits only if its mean over the samples exceeds `BRIGHTEST`. Each
    path loses less than one unit to rounding, which is at most 2^-24 of white paper.
    """
    return UNIT * 2 ** max(0, math.ceil(math.log2(samples / UNIT_SAMPLES)))


def _on_disc(rng: mi.PCG32) -> mi.Point2f:
    """Return a random point of the unit disc."""
    square = mi.Point2f(rng.next_float32(), rng.next_float32())
    return mi.Point2f(mi.warp.square_to_uniform_disk_concentric(square))
