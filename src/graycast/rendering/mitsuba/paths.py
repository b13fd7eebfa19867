"""Light paths through a scene in Dr.Jit, and the contribution of each vertex to every pattern.

The docstring of `renderer.py` explains the method; this file has the implementation.
"""

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ...rig.pattern import Axis
from ..radiance import OnPass
from .caustics import Caustics
from .lens import (
    blur_radius2,
    camera_ray,
    in_field,
    on_pixel,
    picture_place,
    pixel_index,
    pixels_per_sr,
    shines,
    through_focus,
)
from .projector import ShinyField, back_pdf, odds_on_arrival, odds_onward, share
from .sight import DELTA_PDF, counted
from .stage import ROULETTE_FROM, Stage, survival

PASS_SAMPLES = 2_500_000  # Samples of all pixels together between two calls of `on_pass`.
PATCH_LOOKUPS = 3  # Lookups of the patterns over a patch of indirect light.
DISC_LOOKUPS = 6  # Lookups over the blur disc of the projector; opposite pairs keep its centre.

# Steps of additive recurrences, each for a pair of dimensions: M. Roberts' R2 for positions in the
# pixel; roots of primes (Richtmyer) for the pupil and blur of the camera, the pupil and disc of the
# projector, lamps, and the direction from the first vertex.
STEPS = (
    (0.7548776662466927, 0.5698402909980532),
    *(
        (math.sqrt(a) % 1, math.sqrt(b) % 1)
        for a, b in ((2, 3), (5, 7), (11, 13), (17, 19), (23, 29), (31, 37))
    ),
)
PIXEL, CAMERA_PUPIL, CAMERA_BLUR, PROJECTOR_PUPIL, PROJECTOR_DISC, LAMP, ONWARD = range(len(STEPS))


@dataclass
class Paths:
    """The state of the loop, with one path and its pixel's sums per lane."""

    rng: mi.PCG32
    offset: list[mi.Point2f]  # Start of each sample sequence of the pixel
    sample: mi.UInt32
    vertex: mi.UInt32  # Number of the vertex in the path
    alive: mi.Bool  # Whether the path has a next vertex
    throughput: mi.Color3f
    origin: mi.Point3f
    direction: mi.Vector3f
    last_pdf: mi.Float  # Density of the direction that led here
    last_p: mi.Point3f
    last_n: mi.Normal3f
    spread: mi.Float  # Radius of the patch that the vertex represents [m]
    pattern: list[mi.Float]
    white: mi.Color3f
    ambient: mi.Color3f
    albedo: mi.Color3f
    straight: mi.Float  # Direct light of the projector
    placed: mi.Point2f  # Direct light times its positions in the projector's picture
    # Per axis: difference of indirect light under the finest pattern from its mean, and squares.
    stray: dict[Axis, mi.Float]
    stray2: dict[Axis, mi.Float]
    odds: mi.Float  # Odds that a path from the projector finds this path instead
    passed: mi.UInt32 | None = None  # Number of passages through solid glass; None without glass

    def add(self, caustics: Caustics) -> None:
        """Add the light of the paths from the projector."""
        self.white += caustics.white
        for k, light in enumerate(caustics.pattern):
            self.pattern[k] += light
        for axis, squares in caustics.stray2.items():
            self.stray2[axis] += squares


@dataclass
class _Beam:
    """The direct light from the projector at a vertex."""

    wo: mi.Vector3f  # Direction to the lens, local frame
    odds: mi.Float  # Odds of a path from the projector, without the density at the vertex
    lit: mi.Bool  # In the field, on the right side, and not in shadow
    strength: mi.Color3f  # Irradiance of one lookup on a facing surface [W m^-2]
    count: mi.Float  # Number of lookups that are on projector pixels
    places: list[mi.Point2f]  # Projector pixel of each lookup
    shining: list[mi.Bool]  # Whether each lookup is on a projector pixel


@dataclass
class _Lamp:
    """One sample of the light from a lamp or the environment at a vertex."""

    wo: mi.Vector3f  # Direction to the light, local frame
    lit: mi.Bool
    is_point: mi.Bool  # No other technique can find this light.
    pdf: mi.Float
    radiance: mi.Color3f  # Radiance divided by `pdf`; 0 in shadow


class Tracer:
    """The constants of a scene, and the processing of one vertex of every path.

    A lane is a pixel, and all lanes start their next sample together. A lane whose path has ended
    waits for its neighbours. This costs less than it gains: most paths have only two vertices, and
    first vertices in parallel have the same material and nearby memory.
    """

    def __init__(self, stage: Stage, field: ShinyField | None):
        """Prepare tracing; `field` is None if no paths start from the projector."""
        self.stage, self.field, self.sight = stage, field, stage.sight
        self.quality, self.camera, self.projector = stage.quality, stage.camera, stage.light.optics
        self.ambient = len(stage.world.emitters()) > 0
        self.footprint = self.quality.footprint and self.quality.depth > 1
        self.sharp = self.projector.is_pinhole
        # If a lookup can miss all pixels, white is not 1 at each lookup.
        self.gaps = not self.sharp or self.projector.fill_factor < 1
        self.lookups = DISC_LOOKUPS if not self.sharp else PATCH_LOOKUPS if self.footprint else 1

    def trace(self, seed: int, on_pass: OnPass | None = None) -> Paths:
        pixels = self.stage.pixels
        # A literal seed would force a new compilation of the kernel for every scene.
        rng = mi.PCG32(size=pixels, initstate=dr.opaque(mi.UInt64, seed))
        paths = Paths(
            offset=[mi.Point2f(rng.next_float32(), rng.next_float32()) for _ in STEPS],
            rng=rng,
            sample=mi.UInt32(0),
            vertex=mi.UInt32(0),
            alive=mi.Bool(True),
            throughput=mi.Color3f(1),
            origin=mi.Point3f(0),
            direction=mi.Vector3f(0, 0, 1),
            last_pdf=mi.Float(0),
            last_p=mi.Point3f(0),
            last_n=mi.Normal3f(0, 0, 1),
            spread=mi.Float(0),
            pattern=[dr.zeros(mi.Float, pixels) for _ in range(self.stage.patterns.count)],
            white=dr.zeros(mi.Color3f, pixels),
            ambient=dr.zeros(mi.Color3f, pixels),
            albedo=dr.zeros(mi.Color3f, pixels),
            straight=dr.zeros(mi.Float, pixels),
            placed=dr.zeros(mi.Point2f, pixels),
            stray={axis: dr.zeros(mi.Float, pixels) for axis in self.stage.strays},
            stray2={axis: dr.zeros(mi.Float, pixels) for axis in self.stage.strays},
            odds=mi.Float(0),
            passed=mi.UInt32(0) if self.sight.glass else None,
        )
        samples = self.quality.samples
        if on_pass is None:
            return self._until(paths, samples)
        dr.make_opaque(paths)  # All passes then use one kernel, as the state looks the same.
        each = max(1, PASS_SAMPLES // pixels)
        for done in [*range(each, samples, each), samples]:
            paths = self._until(paths, dr.opaque(mi.UInt32, done))
            dr.eval(paths)
            dr.sync_thread()
            on_pass(done, samples)
        return paths

    def _until(self, paths: Paths, sample: int | mi.UInt32) -> Paths:
        """Take samples of every pixel up to the number `sample`."""
        (paths,) = dr.while_loop(
            state=(paths,), cond=lambda p: p.sample < sample, body=lambda p: (self._path(p),)
        )
        return paths

    def _path(self, p: Paths) -> Paths:
        """Take one sample of every pixel."""
        p.origin, p.direction = self._camera_ray(p)
        p.throughput, p.vertex, p.alive = mi.Color3f(1), mi.UInt32(0), mi.Bool(True)
        p.passed = mi.UInt32(0) if self.sight.glass else None
        (p,) = dr.while_loop(state=(p,), cond=lambda p: p.alive, body=lambda p: (self._vertex(p),))
        p.sample += 1
        return p

    def _vertex(self, p: Paths) -> Paths:
        """Find the next vertex, gather its light, and sample the next direction."""
        ray = mi.Ray3f(p.origin, p.direction)
        si, p.throughput, p.rng = self.sight.first(ray, p.throughput, p.rng)
        hit = si.is_valid()
        fresh, last = p.vertex == 0, p.vertex + 1 >= self.quality.depth
        before = dr.select(fresh, 0, p.odds)
        if self.field is not None:
            p.odds = odds_on_arrival(p.odds, si, p.direction, fresh)
        beam = self._beam(p, si, hit)
        lamp = self._lamp(p, si, hit) if self.ambient else None
        pick = p.rng.next_float32()
        uv = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        uv = dr.select(fresh, _in_sequence(p, ONWARD, paired=False), uv)
        # One call does all evaluations of the material, so that it looks up its textures once.
        to_lamp = beam.wo if lamp is None else lamp.wo
        albedo, value, lamp_value, lamp_pdf, bs, gain, lens_back, onward_back = dr.dispatch(
            si.bsdf(ray), self._ask, si, beam.wo, to_lamp, pick, uv
        )
        p.albedo += dr.select(fresh & hit, albedo, 0)
        if self.field is not None:
            shiny = self.field.has(si) & ~fresh
            value *= dr.select(shiny, share(p.odds * beam.odds * lens_back), 1)
        self._add_projector(p, beam, value)
        if lamp is not None:
            self._add_emission(p, si, fresh)
            weight = dr.select(last | lamp.is_point, 1.0, _power_heuristic(lamp.pdf, lamp_pdf))
            gathered = p.throughput * lamp_value * lamp.radiance * weight
            p.ambient += dr.select(lamp.lit, gathered, 0)
        delta = self.sight.is_delta(bs)
        self._go_on(p, si, bs, gain, onward_back, hit & (delta | ~last))
        if p.passed is not None:
            p.odds = dr.select(delta, before, p.odds)
            p.last_pdf = dr.select(delta, DELTA_PDF, p.last_pdf)
            p.passed, p.alive = counted(p.passed, p.alive, delta)
        return p

    def _ask(self, bsdf, si, to_lens, to_lamp, pick, uv):
        """Evaluate a vertex's material and sample a direction.

        Return albedo; value to the projector; value and density to the lamp; the direction and its
        weight; and the densities of a path from the projector for both ways.
        """
        none, no_pdf = mi.Color3f(0), mi.Float(0)
        if bsdf is None:  # The world has no surface.
            return none, none, none, no_pdf, dr.zeros(mi.BSDFSample3f), none, no_pdf, no_pdf
        value = bsdf.eval(self.stage.context, si, to_lens, True)
        lamp_value, lamp_pdf = bsdf.eval_pdf(self.stage.context, si, to_lamp, True)
        bs, gain = bsdf.sample(self.stage.context, si, pick, uv, True)
        albedo, back = bsdf.eval_diffuse_reflectance(si, True), (no_pdf, no_pdf)
        if self.field is not None:
            back = tuple(back_pdf(bsdf, self.stage.context, si, wo) for wo in (to_lens, bs.wo))
        return albedo, value, lamp_value, lamp_pdf, bs, gain, *back

    def _camera_ray(self, p: Paths) -> tuple[mi.Point3f, mi.Vector3f]:
        lane = dr.arange(mi.UInt32, self.camera.width_px * self.camera.height_px)
        side = _side(p)
        aside = (_in_sequence(p, PIXEL) - 0.5) * math.sqrt(self.camera.fill_factor)
        if self.camera.psf_px:
            blur = mi.warp.square_to_uniform_disk_concentric(_in_sequence(p, CAMERA_BLUR))
            aside += self.camera.psf_px * blur
        x = dr.fma(side, aside.x, mi.Float(lane % self.camera.width_px))
        y = dr.fma(side, aside.y, mi.Float(lane // self.camera.width_px))
        start, direction = self.stage.eye, camera_ray(self.camera, x, y)
        central = direction
        if self.camera.aperture_m:
            pupil = mi.warp.square_to_uniform_disk_concentric(_in_sequence(p, CAMERA_PUPIL))
            from_eye, direction = through_focus(self.camera, direction, side * pupil)
            start = start + self.stage.R_world_cam @ from_eye
        if self.field is not None:
            places = pixels_per_sr(self.camera, central, direction) / self.camera.fill_factor
            p.odds = self.field.paths / places
        return mi.Point3f(start), mi.Vector3f(self.stage.R_world_cam @ direction)

    def _beam(self, p: Paths, si, hit: mi.Bool) -> _Beam:
        """Return the projector's direct light, which is I / d^2 inside the projector's field."""
        q = self.stage.light.in_own_frame(si.p)
        place, inverse_z, ahead = picture_place(self.projector, q)
        places = self._spread(p, si, place, inverse_z) if self.lookups > 1 else [place]
        if self.gaps:
            shining = [shines(self.projector, one) for one in places]
            count = sum(dr.select(one, mi.Float(1), 0) for one in shining)
        else:
            shining = [in_field(self.projector, place)] * len(places)
            count = dr.select(shining[0], len(places), 0.0)
        lens = self._projector_pupil(p)
        to_lens = lens - si.p
        inverse_square = dr.rcp(dr.squared_norm(to_lens))
        wo = si.to_local(to_lens * dr.sqrt(inverse_square))
        lit = hit & ahead & (count > 0) & (wo.z > 0) & (si.wi.z > 0)
        lit, passing = self.sight.reaches(si, lens, lit)
        strength = passing * (self.stage.light.intensity(q, place) * inverse_square / len(places))
        odds = mi.Float(0)
        if self.field is not None:
            onto = mi.Vector3f(-to_lens * dr.sqrt(inverse_square))
            odds = self.field.density(onto) * dr.abs(dr.dot(si.n, onto)) * inverse_square
        places = [on_pixel(self.projector, one) for one in places]
        return _Beam(wo, odds, lit, strength, count, places, shining)

    def _add_projector(self, p: Paths, beam: _Beam, value: mi.Color3f) -> None:
        """Add the beam to each pattern, weighted by the pattern's level."""
        arriving = dr.select(beam.lit, p.throughput * value * beam.strength, 0) * self.stage.weights
        p.white += arriving * beam.count
        mono, lit = dr.sum(arriving), [beam.lit & one for one in beam.shining]
        light, fresh = mono * beam.count, p.vertex == 0
        p.straight += dr.select(fresh, light, 0)
        middle = sum(dr.select(one, place, 0) for place, one in zip(beam.places, lit, strict=True))
        p.placed += dr.select(fresh, mono, 0) * middle
        pixels = [pixel_index(self.projector, place) for place in beam.places]
        before = {
            axis: mi.Float(p.pattern[fine.number]) for axis, fine in self.stage.strays.items()
        }
        self.stage.patterns.add(p.pattern, mono, pixels, lit)
        for axis, fine in self.stage.strays.items():
            off = (p.pattern[fine.number] - before[axis] - fine.mean * light) / fine.deviation
            off = dr.select(fresh, 0, off)
            p.stray[axis] += off
            p.stray2[axis] += dr.square(off)

    def _projector_pupil(self, p: Paths) -> mi.Point3f:
        """Return the end of the shadow ray, which is a random point of the projector's lens."""
        if self.projector.aperture_m == 0:
            return self.stage.light.lens
        random = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        random = dr.select(p.vertex == 0, _in_sequence(p, PROJECTOR_PUPIL), random)
        return self.stage.light.on_lens(
            _side(p) * mi.warp.square_to_uniform_disk_concentric(random)
        )

    def _spread(self, p: Paths, si, place: mi.Point2f, inverse_z: mi.Float) -> list[mi.Point2f]:
        """Return positions spread over the disc of the projector's picture that lights this vertex.

        At the first vertex the disc is the projector's blur; opposite pairs keep its exact centre.
        A later vertex represents a patch of surface, whose radius is added in quadrature.
        """
        random = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        radius2 = mi.Float(0)
        if self.footprint:
            grown = si.t * dr.sqrt(dr.inv_pi / (self.quality.samples * p.last_pdf))
            p.spread = dr.select(p.vertex == 0, 0, p.spread + dr.select(p.last_pdf > 0, grown, 0))
            radius2 = dr.square(p.spread * inverse_z)
        if not self.sharp:
            radius2 += blur_radius2(self.projector, inverse_z)
            random = dr.select(p.vertex == 0, _in_sequence(p, PROJECTOR_DISC), random)
        sine, cosine = dr.sincos(dr.two_pi * random.y)
        radius, mirrored = dr.sqrt(radius2), _side(p) < 0
        rings = PATCH_LOOKUPS
        places = []
        for j in range(self.lookups):
            # Positions cycle through rings of equal area, from a random start. The two samples of a
            # pair use complementary areas, so together they have the second moments of the disc.
            area = random.x + (j % rings) / rings
            area -= dr.floor(area)
            area = dr.select(mirrored, 1 - area, area)
            angle = 2 * math.pi * (j % rings) / self.lookups + math.pi * (j // rings)
            c, s = math.cos(angle), math.sin(angle)
            aside = mi.Vector2f(c * cosine - s * sine, s * cosine + c * sine)
            aside *= radius * dr.sqrt(area)
            x = dr.fma(aside.x, self.projector.fx_px, place.x)
            places.append(mi.Point2f(x, dr.fma(aside.y, self.projector.fy_px, place.y)))
        return places

    def _add_emission(self, p: Paths, si, fresh: mi.Bool) -> None:
        """Add light of lamps and environment that a sampled direction happened to meet."""
        previous = dr.zeros(mi.Interaction3f)
        previous.p, previous.n = p.last_p, p.last_n
        ds = mi.DirectionSample3f(self.stage.world, si, previous)
        light_pdf = self.stage.world.pdf_emitter_direction(previous, ds, ~fresh)
        weight = dr.select(fresh, 1.0, _power_heuristic(p.last_pdf, light_pdf))
        p.ambient += p.throughput * si.emitter(self.stage.world).eval(si) * weight

    def _lamp(self, p: Paths, si, hit: mi.Bool) -> _Lamp:
        """Sample lamps and environment by a shadow ray, the only method at the last vertex.

        The first sample of a pair does this for both samples. A low-discrepancy sequence at first
        vertices removes as much noise as this sharing adds.
        """
        samples, asking = self.quality.samples, hit & ((p.sample & 1) == 0)
        uv = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        uv = dr.select(p.vertex == 0, _in_sequence(p, LAMP), uv)
        ds, radiance = self.sight.lamp(si, uv, asking)
        radiance *= samples / ((samples + 1) // 2)
        return _Lamp(si.to_local(ds.d), asking & (ds.pdf > 0), ds.delta, ds.pdf, radiance)

    def _go_on(self, p: Paths, si, bs, gain, back: mi.Float, hit: mi.Bool) -> None:
        """Follow the sampled direction, or end the path."""
        p.throughput = dr.select(hit, p.throughput * gain, 0)
        playing = (p.vertex + 1 >= ROULETTE_FROM) & ~self.sight.is_delta(bs)
        share_left = survival(p.throughput, playing | (dr.max(p.throughput) == 0))
        alive = hit & (p.rng.next_float32() < share_left)
        p.throughput = dr.select(alive, p.throughput / share_left, 0)
        onward = self.sight.onward(si, bs)
        if self.field is not None:
            p.odds = odds_onward(p.odds, back, bs.pdf, si, onward.d, p.vertex == 0)
        p.origin, p.direction = onward.o, onward.d
        p.last_pdf, p.last_p, p.last_n = bs.pdf, si.p, si.n
        p.vertex += dr.select(self.sight.is_delta(bs), mi.UInt32(0), 1)
        p.alive = alive


def _side(p: Paths) -> mi.Float:
    """Return 1 for the first sample of a pair and -1 for the second, which mirrors it."""
    return dr.select((p.sample & 1) == 0, mi.Float(1), -1)


def _in_sequence(p: Paths, pair: int, *, paired: bool = True) -> mi.Point2f:
    """Return a point of the pixel's low-discrepancy sequence, one for each sample or pair."""
    n = mi.Float(p.sample >> 1 if paired else p.sample)
    step, offset = STEPS[pair], p.offset[pair]
    point = mi.Point2f(dr.fma(n, step[0], offset.x), dr.fma(n, step[1], offset.y))
    return point - dr.floor(point)


def _power_heuristic(a: mi.Float, b: mi.Float) -> mi.Float:
    """Return the weight of technique a against b (E. Veach, 1997, power 2); 0 if a cannot occur."""
    return dr.select(a > 0, dr.square(a) / dr.fma(a, a, dr.square(b)), 0)
