"""Light paths from the projector over shiny surfaces to the camera: caustics, for all patterns.

A path from the camera finds light that comes by a polished face only if its diffuse choice at the
lit surface happens to meet the one spot that mirrors the small lens of the projector: rare, and
then very bright. A path from the projector goes over that spot by itself. It starts at a place of
the projector's picture, whose levels it carries. At each vertex from the second on, it is connected
with a place of the camera's pupil and added to the pixel there, as far as nothing is between them.

Most of this light both kinds of path can find, so each counts what multiple importance sampling
leaves it (`share`): the odds that the other kind would have found the path. Direct light, and light
whose first surface is not shiny, is looked for from the camera alone.

Both kinds integrate the same: a material is asked with light and camera on the same sides, and each
bounce takes the cosines to the true normal that its density lacks, which is Veach's factor for
interpolated normals. Out of focus, the path's place in the projector's picture is one of the disc
over which the paths from the camera take a mean.

The sums are integers of 64 bits, so that they are the same in whatever order threads add. While the
paths run, they take 8 bytes for each pixel and each of the patterns, the three bands and the finest
pattern of each axis (docs/how-to/many-scenes.md).

Source: E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997: sections 5.3,
9.2 and 10.2 (bidirectional path tracing; this is t = 1 beside s = 1).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..rig.pattern import Axis
from .mitsuba_lens import blur_radius2, camera_place, on_pixel, picture_place, pixel_index, shines
from .mitsuba_projector import ShinyField, odds_on_arrival, odds_onward, share
from .mitsuba_sight import counted
from .mitsuba_stage import ROULETTE_FROM, Stage, survival

LANES = 2_500_000  # At most so many paths run side by side.
UNIT = 2.0**-32  # It is the unit of the sums, in light that white paper at one metre returns.
BRIGHTEST = 2.0**24 - 1  # In the same light, one path adds no more to a pixel.
UNIT_SAMPLES = 256  # So many times BRIGHTEST fit into 64 bits in UNIT; more samples widen the unit.


@dataclass(frozen=True, slots=True)
class Caustics:
    """What the paths from the projector add to the sums of each pixel."""

    pattern: list[mi.Float]
    white: mi.Color3f
    stray2: Mapping[Axis, mi.Float]  # the variance of the finest pattern's sum


@dataclass
class _LightPaths:
    """One path per lane: the state of the loop."""

    rng: mi.PCG32
    vertex: mi.UInt32
    alive: mi.Bool
    throughput: mi.Color3f
    origin: mi.Point3f
    direction: mi.Vector3f
    odds: mi.Float
    power: mi.Float  # that the path carries, without `throughput`
    pixel: mi.UInt32  # of the projector's picture
    passed: mi.UInt32 | None  # how often solid glass has sent it on, where there is glass


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
        """Follow all paths, block by block, and return what they add."""
        starts = mi.PCG32(size=2, initstate=dr.opaque(mi.UInt64, seed)).next_uint32().numpy()
        start = mi.Point2u(*(dr.opaque(mi.UInt32, int(one)) for one in starts))
        for first, lanes in blocks(self.total):
            # 64 bits: a full picture with some thousands of samples has more than 2^32 paths.
            index = dr.arange(mi.UInt64, lanes) + dr.opaque(mi.UInt64, first)
            # Not the numbers of the paths from the camera, which are those of `seed`.
            state = dr.opaque(mi.UInt64, (seed * 0x9E3779B97F4A7C15 + first + 1) % 2**64)
            paths = self._started(mi.PCG32(size=lanes, initstate=state), index, start)
            (paths,) = dr.while_loop(
                state=(paths,), cond=lambda p: p.alive, body=lambda p: (self._vertex(p),)
            )
            dr.eval(self.sums, paths.alive)
        return self._result()

    def _started(self, rng: mi.PCG32, index: mi.UInt64, start: mi.Point2u) -> _LightPaths:
        """Paths that have met their first surface, if that is shiny, and go on from there."""
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
        """Return the projector's pixel of a path seen at `place`, and whether it shines."""
        optics = self.projector
        if not optics.is_pinhole:
            disc = _on_disc(rng) * dr.sqrt(blur_radius2(optics, inverse_z))
            x, y = place.x + disc.x * optics.fx_px, place.y + disc.y * optics.fy_px
            place = mi.Point2f(x, y)
        return pixel_index(optics, on_pixel(optics, place)), shines(optics, place)

    def _vertex(self, p: _LightPaths) -> _LightPaths:
        """Find the next vertex, add its light to the pixel that sees it, and go on."""
        stage, camera = self.stage, self.camera
        ray = mi.Ray3f(p.origin, p.direction)
        si, p.throughput, p.rng = self.sight.first(ray, p.throughput, p.rng)
        hit = p.alive & si.is_valid()
        if not self.sight.glass:  # glass alone sends on what comes from inside
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
        # Per path of a pixel, whose places are all over what senses of it.
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
        """Value and density of the way from the camera to where this path came from; a way on, and
        the same of it.
        """
        if bsdf is None:  # a world without any surface
            none = mi.Color3f(0)
            return none, mi.Float(0), dr.zeros(mi.BSDFSample3f), none, mi.Float(0)
        context = self.stage.context
        bs, gain = bsdf.sample(self.power, si, pick, uv, True)
        back, onward = mi.SurfaceInteraction3f(si), mi.SurfaceInteraction3f(si)
        back.wi, onward.wi = to_camera, bs.wo
        value, pdf = bsdf.eval_pdf(context, back, si.wi, True)
        onward_value, onward_pdf = bsdf.eval_pdf(context, onward, si.wi, True)
        # Glass has no value there, but a weight.
        onward_value = dr.select(self.sight.is_delta(bs), gain, onward_value)
        return value, pdf, bs, onward_value, onward_pdf

    def _go_on(
        self, p: _LightPaths, si, bs, value: mi.Color3f, pdf: mi.Float, before: mi.Float | None
    ) -> _LightPaths:
        """Take the sampled direction, or end the path; the first vertex has no odds `before` it."""
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
        """Light to the sums of a pixel of the camera."""
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
    """Yield the first path and the number of paths of each block that runs side by side."""
    for first in range(0, total, LANES):
        yield first, min(LANES, total - first)


def sum_step(samples: int) -> float:
    """Return the unit of the sums for a number of samples, in light of white paper at one metre.

    It is `UNIT` for up to `UNIT_SAMPLES` samples, and a power of two times that for more, so that
    the sum of a pixel overflows 64 bits only if its mean over the samples exceeds `BRIGHTEST`. Each
    path loses less than one unit to rounding, which is 2^-24 of white paper with the most samples.
    """
    return UNIT * 2 ** max(0, math.ceil(math.log2(samples / UNIT_SAMPLES)))


def _on_disc(rng: mi.PCG32) -> mi.Point2f:
    """A place of the unit disc."""
    square = mi.Point2f(rng.next_float32(), rng.next_float32())
    return mi.Point2f(mi.warp.square_to_uniform_disk_concentric(square))
