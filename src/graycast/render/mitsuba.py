"""The one-pass renderer: every projected pattern from one set of light paths, by Mitsuba 3.

Light transport is linear in the projector's picture and the scene stands still. So a path from
the camera is traced once, and at each of its vertices the light that arrives straight from the
projector goes to every pattern's sum, weighted by that pattern's level at the projector pixel which
sees the vertex. All patterns share their paths: their Monte Carlo errors are one error, as if the
picture were taken through slightly different pixels, not an error that differs from bit to bit.
The noise that does is the sensor's, added later.

One of n samples of a rough reflection stands for a cone of directions, and its end for a patch of
surface, not for a point of one stripe. So interreflected light takes the patterns' mean level over
the patch that its vertex stands for (`Quality.footprint`), as ray cones filter textures. The patch
shrinks with the number of samples: the estimate is consistent, the white frame is untouched, and
stripes seen in a rough reflection blur, as they do in the limit, rather than sparkle.

Both lenses are thin (`Optics`). Paths start all over the camera's pupil. What lights a point by
the projector's is a disc of its picture, so patterns take their mean level over that disc, too. A
pixel's samples come in pairs that mirror each other: it sees a smooth surface at its exact middle.

Limits: no light passes through a surface; a surface smoother than roughness 0.05 is refused, since
paths cannot find a small projector lens's mirror image. The shadow ray goes to a random place of
the projector's lens, but the patterns are averaged over the whole of it: half shadows are as soft
as they should be, and their stripes are not shifted by the half of the lens that is hidden.
"""

import math
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..frames import inverse
from ..optics import relative_illumination
from ..rig import Rig
from ..scene import Layout, Scene
from .denoise import denoised
from .mitsuba_lens import (
    blur_radius2,
    camera_ray,
    in_field,
    pixel_index,
    seen_by_projector,
    shines,
    through_focus,
)
from .mitsuba_patterns import bit_counts, packed
from .mitsuba_scene import build
from .mitsuba_truth import truth
from .radiance import Denoiser, Quality, Radiance, Rendering
from .wavelength import at_projector_wavelength

ROULETTE_FROM = 2  # vertices that every path gets before Russian roulette
MAX_SURVIVAL = 0.95  # ends paths between perfect whites
PATCH_LOOKUPS = 3  # over a patch of interreflected light
DISC_LOOKUPS = 6  # over the disc of a defocused projector: pairs, so that stripes stay in place

# Steps of additive recurrences, a pair of dimensions each: M. Roberts' R2 for places in the pixel;
# roots of primes (Richtmyer) for the camera's pupil and blur, the projector's pupil and disc.
STEPS = (
    (0.7548776662466927, 0.5698402909980532),
    *((math.sqrt(a) % 1, math.sqrt(b) % 1) for a, b in ((2, 3), (5, 7), (11, 13), (17, 19))),
)
PIXEL, CAMERA_PUPIL, CAMERA_BLUR, PROJECTOR_PUPIL, PROJECTOR_DISC = range(len(STEPS))


@final
class MitsubaRenderer:
    """See the module. Each call builds its scene and lets it go; the device stays open."""

    name = "mitsuba"

    def __init__(self, device: str):
        self.device = device
        self.denoiser: Denoiser = "optix" if device == "cuda" else "oidn"
        self.versions = {name: version(name) for name in ("mitsuba", "drjit")}

    def render(
        self,
        scene: Scene,
        layout: Layout,
        pattern: np.ndarray,
        *,
        quality: Quality,
        seed: int,
    ) -> Rendering:
        _refuse(scene.rig, pattern, quality)
        measured = at_projector_wavelength(scene)
        world, part_shapes = build(measured, layout)
        radiance = light(world, measured, pattern, quality=quality, seed=seed)
        if measured is not scene:
            look = light(build(scene, layout)[0], scene, pattern[:0], quality=quality, seed=seed)
            radiance = replace(
                radiance,
                white_rgb=look.white_rgb,
                ambient_rgb=look.ambient_rgb,
                albedo=look.albedo,
            )
        seen = truth(world, part_shapes, scene, layout)
        if quality.denoise != "none":
            radiance = denoised(radiance, seen.normal, quality.denoise)
        return Rendering(radiance=radiance, truth=seen)

    def close(self) -> None:
        """A process keeps its Mitsuba device to its end."""

    def __enter__(self) -> "MitsubaRenderer":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _refuse(rig: Rig, pattern: np.ndarray, quality: Quality) -> None:
    projector = rig.projector
    if pattern.shape[1:] != (projector.height_px, projector.width_px):
        size = f"{pattern.shape[2]} x {pattern.shape[1]}"
        wanted = f"{projector.width_px} x {projector.height_px}"
        raise ValueError(f"patterns are {size} px, the projector is {wanted} px")
    if rig.speckle_contrast**2 * quality.samples > 1:
        raise ValueError(
            f"speckle_contrast is {rig.speckle_contrast} with {quality.samples} samples, too many: "
            f"use {int(1 / rig.speckle_contrast**2)} samples or fewer, or less contrast"
        )


def light(
    world: mi.Scene, scene: Scene, pattern: np.ndarray, *, quality: Quality, seed: int
) -> Radiance:
    camera = scene.rig.camera
    h, w = camera.height_px, camera.width_px
    paths = _Tracer(world, scene, pattern, quality).trace(seed)
    dr.eval(paths)

    share = (relative_illumination(camera) / quality.samples).astype(np.float32)
    stack = np.empty((len(pattern), h, w), dtype=np.float32)
    for k, channel in enumerate(paths.pattern):
        np.multiply(channel.numpy().reshape(h, w), share, out=stack[k])

    def colour(channels: mi.Color3f, share: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(channels.numpy().T).reshape(h, w, 3) * share[..., None]

    white_rgb, ambient_rgb = colour(paths.white, share), colour(paths.ambient, share)
    return Radiance(
        pattern=stack,
        white=white_rgb.sum(axis=-1),
        ambient=ambient_rgb @ np.array(scene.rig.passed_bands, dtype=np.float32),
        white_rgb=white_rgb,
        ambient_rgb=ambient_rgb,
        albedo=colour(paths.albedo, np.full((h, w), 1 / quality.samples, dtype=np.float32)),
    )


@dataclass
class _Paths:
    """One path and its pixel's sums per lane: the state of the loop."""

    rng: mi.PCG32
    offset: list[mi.Point2f]  # of the pixel's sample sequences
    sample: mi.UInt32
    vertex: mi.UInt32  # of the path; 0 asks for a new one
    throughput: mi.Color3f
    origin: mi.Point3f
    direction: mi.Vector3f
    last_pdf: mi.Float  # of the direction that led here
    last_p: mi.Point3f
    last_n: mi.Normal3f
    spread: mi.Float  # radius of what the vertex stands for [m]
    pattern: list[mi.Float]
    white: mi.Color3f
    ambient: mi.Color3f
    albedo: mi.Color3f


class _Tracer:
    """The scene's constants, and what happens at one vertex of every path.

    A lane is a pixel. A lane whose path has ended takes up its next sample at once, so none waits
    for the longest path among its neighbours.
    """

    def __init__(self, world: mi.Scene, scene: Scene, pattern: np.ndarray, quality: Quality):
        rig = scene.rig
        T_world_proj = scene.T_world_cam @ rig.T_cam_proj
        self.world, self.quality = world, quality
        self.camera, self.projector = rig.camera, rig.projector
        self.R_world_cam = mi.Matrix3f(scene.T_world_cam[:3, :3])
        self.R_world_proj = mi.Matrix3f(T_world_proj[:3, :3])
        self.eye = mi.Point3f(scene.T_world_cam[:3, 3])
        self.T_proj_world = mi.Matrix4f(inverse(T_world_proj))
        self.lens = mi.Point3f(T_world_proj[:3, 3])
        self.intensity_w_sr = rig.intensity_w_sr
        self.weights = mi.Color3f(rig.band_weights)
        self.context = mi.BSDFContext()
        self.ambient = len(world.emitters()) > 0
        self.pattern_count = len(pattern)
        self.words, self.bits_each = packed(pattern, rig)
        self.footprint = quality.footprint and quality.depth > 1
        self.sharp = rig.projector.is_pinhole
        # Where a lookup can miss all pixels, white is no longer 1 at each.
        self.gaps = not self.sharp or rig.projector.fill_factor < 1
        self.lookups = DISC_LOOKUPS if not self.sharp else PATCH_LOOKUPS if self.footprint else 1
        self.speckle = rig.speckle_contrast * math.sqrt(quality.samples)

    def trace(self, seed: int) -> _Paths:
        pixels = self.camera.width_px * self.camera.height_px
        # A literal seed would be compiled into the kernel, anew for every scene.
        rng = mi.PCG32(size=pixels, initstate=dr.opaque(mi.UInt64, seed))
        paths = _Paths(
            offset=[mi.Point2f(rng.next_float32(), rng.next_float32()) for _ in STEPS],
            rng=rng,
            sample=mi.UInt32(0),
            vertex=mi.UInt32(0),
            throughput=mi.Color3f(1),
            origin=mi.Point3f(0),
            direction=mi.Vector3f(0, 0, 1),
            last_pdf=mi.Float(0),
            last_p=mi.Point3f(0),
            last_n=mi.Normal3f(0, 0, 1),
            spread=mi.Float(0),
            pattern=[dr.zeros(mi.Float, pixels) for _ in range(self.pattern_count)],
            white=dr.zeros(mi.Color3f, pixels),
            ambient=dr.zeros(mi.Color3f, pixels),
            albedo=dr.zeros(mi.Color3f, pixels),
        )
        samples = self.quality.samples
        (paths,) = dr.while_loop(
            state=(paths,), cond=lambda p: p.sample < samples, body=lambda p: (self._vertex(p),)
        )
        return paths

    def _vertex(self, p: _Paths) -> _Paths:
        """Find the vertex, gather its light, choose the way on."""
        fresh = p.vertex == 0
        start, direction = self._camera_ray(p)
        p.origin = dr.select(fresh, start, p.origin)
        p.direction = dr.select(fresh, direction, p.direction)
        p.throughput = dr.select(fresh, mi.Color3f(1), p.throughput)
        ray = mi.Ray3f(p.origin, p.direction)
        si = self.world.ray_intersect(ray)
        hit = si.is_valid()
        bsdf = si.bsdf(ray)
        last = p.vertex + 1 >= self.quality.depth
        p.albedo += dr.select(fresh & hit, bsdf.eval_diffuse_reflectance(si, hit), 0)
        self._add_projector(p, si, bsdf, hit)
        if self.ambient:
            self._add_emission(p, si, fresh)
            self._add_lamps(p, si, bsdf, hit, last)
        self._go_on(p, si, bsdf, hit & ~last)
        return p

    def _camera_ray(self, p: _Paths) -> tuple[mi.Point3f, mi.Vector3f]:
        lane = dr.arange(mi.UInt32, self.camera.width_px * self.camera.height_px)
        side = _side(p)
        aside = (_in_sequence(p, PIXEL) - 0.5) * math.sqrt(self.camera.fill_factor)
        if self.camera.psf_px:
            blur = mi.warp.square_to_uniform_disk_concentric(_in_sequence(p, CAMERA_BLUR))
            aside += self.camera.psf_px * blur
        x = dr.fma(side, aside.x, mi.Float(lane % self.camera.width_px))
        y = dr.fma(side, aside.y, mi.Float(lane // self.camera.width_px))
        direction = camera_ray(self.camera, x, y)
        start = self.eye
        if self.camera.aperture_m:
            pupil = mi.warp.square_to_uniform_disk_concentric(_in_sequence(p, CAMERA_PUPIL))
            from_eye, direction = through_focus(self.camera, direction, side * pupil)
            start = start + self.R_world_cam @ from_eye
        return mi.Point3f(start), mi.Vector3f(self.R_world_cam @ direction)

    def _add_projector(self, p: _Paths, si, bsdf, hit: mi.Bool) -> None:
        """Light straight from the projector: I / d^2 in the field, to each pattern by its level."""
        q = self.T_proj_world @ mi.Vector4f(si.p.x, si.p.y, si.p.z, 1)
        q = mi.Point3f(q.x, q.y, q.z)
        place, inverse_z, ahead = seen_by_projector(self.projector, q)
        places = self._spread(p, si, place, inverse_z) if self.lookups > 1 else [place]
        pixels = [pixel_index(self.projector, one) for one in places]
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
        lit &= ~self.world.ray_test(si.spawn_ray_to(lens), lit)
        value = dr.select(lit, bsdf.eval(self.context, si, wo, lit), 0)
        seen = p.throughput * value * (self.intensity_w_sr * inverse_square)
        seen *= self.weights
        if self.projector.natural_vignetting:
            seen *= q.z * dr.rsqrt(dr.squared_norm(q))
        if self.speckle:
            bright = -dr.log(1 - p.rng.next_float32())  # of fully developed speckle, mean 1
            seen *= dr.select(p.vertex == 0, 1 + self.speckle * (bright - 1), 1)
        seen /= len(places)
        p.white += seen * count
        self._add_levels(p, dr.sum(seen), pixels, [lit & one for one in shining])

    def _projector_pupil(self, p: _Paths) -> mi.Point3f:
        """Where the shadow ray ends: a place of the projector's lens."""
        if self.projector.aperture_m == 0:
            return self.lens
        random = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        random = dr.select(p.vertex == 0, _in_sequence(p, PROJECTOR_PUPIL), random)
        place = mi.warp.square_to_uniform_disk_concentric(random)
        place *= 0.5 * self.projector.aperture_m * _side(p)
        return mi.Point3f(self.lens + self.R_world_proj @ mi.Vector3f(place.x, place.y, 0))

    def _spread(self, p: _Paths, si, place: mi.Point2f, inverse_z: mi.Float) -> list[mi.Point2f]:
        """Places all over the disc of the projector's picture for which this vertex stands.

        At the first vertex the disc is the projector's blur, and opposite pairs of places keep its
        middle exactly. Later ones stand for a patch of surface too, added in quadrature.
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
            # Equal areas of the disc in turn, from a random start; a pair of samples takes each
            # area and what it lacks of the whole, and has the second moments of the disc.
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

    def _add_levels(
        self, p: _Paths, mono: mi.Float, pixels: list[mi.UInt32], lit: list[mi.Bool]
    ) -> None:
        """To each pattern its levels at the pixels, each times `mono`."""
        per_word = 32 // self.bits_each
        for first in range(0, self.pattern_count, per_word):
            words = self.words[first // per_word]
            levels = [
                dr.gather(mi.UInt32, words, pixel, one)
                for pixel, one in zip(pixels, lit, strict=True)
            ]
            used = min(per_word, self.pattern_count - first) * self.bits_each
            shifts = range(0, used, self.bits_each)
            if self.bits_each == 1:
                planes = bit_counts(levels)
                shares = [mono * 2**i for i in range(len(planes))]
                for k, shift in enumerate(shifts, start=first):
                    for plane, share in zip(planes, shares, strict=True):
                        p.pattern[k] += dr.select((plane & (1 << shift)) != 0, share, 0)
            else:
                most = 2**self.bits_each - 1
                share = mono / most
                for k, shift in enumerate(shifts, start=first):
                    total = sum((level >> shift) & most for level in levels)
                    p.pattern[k] += share * mi.Float(total)

    def _add_emission(self, p: _Paths, si, fresh: mi.Bool) -> None:
        """Lamps and environment that a sampled direction happened to meet."""
        previous = dr.zeros(mi.Interaction3f)
        previous.p, previous.n = p.last_p, p.last_n
        ds = mi.DirectionSample3f(self.world, si, previous)
        light_pdf = self.world.pdf_emitter_direction(previous, ds, ~fresh)
        weight = dr.select(fresh, 1.0, _power_heuristic(p.last_pdf, light_pdf))
        p.ambient += p.throughput * si.emitter(self.world).eval(si) * weight

    def _add_lamps(self, p: _Paths, si, bsdf, hit: mi.Bool, last: mi.Bool) -> None:
        """Lamps and environment by a shadow ray; the last vertex has no other way to them."""
        uv = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        ds, emitted = self.world.sample_emitter_direction(si, uv, True, hit)
        wo = si.to_local(ds.d)
        value, bsdf_pdf = bsdf.eval_pdf(self.context, si, wo, hit & (ds.pdf > 0))
        weight = dr.select(last | ds.delta, 1.0, _power_heuristic(ds.pdf, bsdf_pdf))
        p.ambient += dr.select(hit, p.throughput * value * emitted * weight, 0)

    def _go_on(self, p: _Paths, si, bsdf, hit: mi.Bool) -> None:
        """Sample the next direction, or end the path and start the pixel's next sample."""
        pick = p.rng.next_float32()
        uv = mi.Point2f(p.rng.next_float32(), p.rng.next_float32())
        bs, gain = bsdf.sample(self.context, si, pick, uv, hit)
        p.throughput = dr.select(hit, p.throughput * gain, 0)
        survival = dr.minimum(dr.max(p.throughput), MAX_SURVIVAL)
        survival = dr.select((p.vertex + 1 >= ROULETTE_FROM) | (survival == 0), survival, 1.0)
        alive = hit & (p.rng.next_float32() < survival)
        p.throughput = dr.select(alive, p.throughput / survival, 0)
        onward = si.spawn_ray(si.to_world(bs.wo))
        p.origin, p.direction = onward.o, onward.d
        p.last_pdf, p.last_p, p.last_n = bs.pdf, si.p, si.n
        p.vertex = dr.select(alive, p.vertex + 1, 0)
        p.sample = dr.select(alive, p.sample, p.sample + 1)


def _side(p: _Paths) -> mi.Float:
    """1 for the first sample of a pair, -1 for the second, which mirrors it."""
    return dr.select((p.sample & 1) == 0, mi.Float(1), -1)


def _in_sequence(p: _Paths, pair: int) -> mi.Point2f:
    """Where the pixel's low-discrepancy sequence is: one step for each pair of samples."""
    n = mi.Float(p.sample >> 1)
    step, offset = STEPS[pair], p.offset[pair]
    point = mi.Point2f(dr.fma(n, step[0], offset.x), dr.fma(n, step[1], offset.y))
    return point - dr.floor(point)


def _power_heuristic(a: mi.Float, b: mi.Float) -> mi.Float:
    """Weight of technique a against b (E. Veach, 1997, power 2); 0 where a cannot occur."""
    return dr.select(a > 0, dr.square(a) / dr.fma(a, a, dr.square(b)), 0)
