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

Limits: no light passes through a surface; a surface smoother than roughness 0.05 is refused, since
paths cannot find a pinhole projector's mirror image.
"""

import math
from dataclasses import dataclass
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..frames import inverse, transform_points
from ..optics import Optics, fold_radius2, project
from ..scene import Layout, Scene
from .mitsuba_scene import PartShape, build
from .radiance import GroundTruth, Quality, Radiance, Rendering, Silhouette

NEWTON_STEPS = 6  # double the digits each; lenses need four for float32
STEP_THROUGH_M = 2e-5  # past a surface: float32 errs by less, parts that touch overlap by less
ROULETTE_FROM = 2  # vertices that every path gets before Russian roulette
MAX_SURVIVAL = 0.95  # ends paths between perfect whites
FOOTPRINT_LOOKUPS = 7  # what `_bit_counts` counts in three bits
OUTLINE_POINTS = 33  # on each side of a part's box, which distortion bends
R2 = (0.7548776662466927, 0.5698402909980532)  # M. Roberts' low-discrepancy additive recurrence


@final
class MitsubaRenderer:
    """See the module. Holds nothing: each call builds its scene and lets it go."""

    def render(
        self,
        scene: Scene,
        layout: Layout,
        pattern: np.ndarray,
        *,
        quality: Quality,
        seed: int,
    ) -> Rendering:
        projector = scene.rig.projector
        if pattern.shape[1:] != (projector.height_px, projector.width_px):
            size = f"{pattern.shape[2]} x {pattern.shape[1]}"
            raise ValueError(
                f"patterns are {size} px, the projector is "
                f"{projector.width_px} x {projector.height_px} px"
            )
        world, part_shapes = build(scene, layout)
        radiance = light(world, scene, pattern, quality=quality, seed=seed)
        return Rendering(radiance=radiance, truth=truth(world, part_shapes, scene, layout))


# --- light -----------------------------------------------------------------------------------


def light(
    world: mi.Scene, scene: Scene, pattern: np.ndarray, *, quality: Quality, seed: int
) -> Radiance:
    camera = scene.rig.camera
    h, w = camera.height_px, camera.width_px
    paths = _Tracer(world, scene, pattern, quality).trace(seed)
    dr.eval(paths)

    share = np.float32(1 / quality.samples)
    stack = np.empty((len(pattern), h, w), dtype=np.float32)
    for k, channel in enumerate(paths.pattern):
        np.multiply(channel.numpy().reshape(h, w), share, out=stack[k])

    def colour(channels: mi.Color3f) -> np.ndarray:
        return np.ascontiguousarray(channels.numpy().T).reshape(h, w, 3) * share

    return Radiance(
        pattern=stack,
        white_rgb=colour(paths.white),
        ambient_rgb=colour(paths.ambient),
        albedo=colour(paths.albedo),
    )


def _packed(pattern: np.ndarray) -> tuple[list[mi.UInt32], int]:
    """Patterns as 32-bit words per projector pixel: one bit each if all are binary, else a byte."""
    binary = bool(np.isin(pattern, (0, 255)).all())
    bits_each = 1 if binary else 8
    per_word = 32 // bits_each
    level = (pattern >> 7 if binary else pattern).astype(np.uint32)
    words = []
    for first in range(0, len(level), per_word):
        word = np.zeros(level.shape[1:], dtype=np.uint32)
        for k, image in enumerate(level[first : first + per_word]):
            word |= image << np.uint32(k * bits_each)
        words.append(mi.UInt32(word.ravel()))
    return words, bits_each


@dataclass
class _Paths:
    """One path and its pixel's sums per lane: the state of the loop."""

    rng: mi.PCG32
    offset: mi.Point2f  # of the pixel's sample sequence
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
        self.eye = mi.Point3f(scene.T_world_cam[:3, 3])
        self.T_proj_world = mi.Matrix4f(inverse(T_world_proj))
        self.lens = mi.Point3f(T_world_proj[:3, 3])
        self.intensity_w_sr = rig.intensity_w_sr
        self.weights = mi.Color3f(rig.band_weights)
        self.context = mi.BSDFContext()
        self.ambient = len(world.emitters()) > 0
        self.pattern_count = len(pattern)
        self.words, self.bits_each = _packed(pattern)
        self.footprint = quality.footprint and quality.depth > 1

    def trace(self, seed: int) -> _Paths:
        pixels = self.camera.width_px * self.camera.height_px
        # A literal seed would be compiled into the kernel, anew for every scene.
        rng = mi.PCG32(size=pixels, initstate=dr.opaque(mi.UInt64, seed))
        paths = _Paths(
            offset=mi.Point2f(rng.next_float32(), rng.next_float32()),
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
        p.origin = dr.select(fresh, self.eye, p.origin)
        p.direction = dr.select(fresh, self._camera_direction(p), p.direction)
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

    def _camera_direction(self, p: _Paths) -> mi.Vector3f:
        lane = dr.arange(mi.UInt32, self.camera.width_px * self.camera.height_px)
        n = mi.Float(p.sample)
        jitter = mi.Point2f(dr.fma(n, R2[0], p.offset.x), dr.fma(n, R2[1], p.offset.y))
        jitter -= dr.floor(jitter)
        x = mi.Float(lane % self.camera.width_px) + jitter.x - 0.5
        y = mi.Float(lane // self.camera.width_px) + jitter.y - 0.5
        return mi.Vector3f(self.R_world_cam @ _camera_ray(self.camera, x, y))

    def _add_projector(self, p: _Paths, si, bsdf, hit: mi.Bool) -> None:
        """Light straight from the projector: I / d^2 in the field, to each pattern by its level."""
        place, focal_px, in_field = _projector_place(self.projector, self.T_proj_world, si.p)
        to_lens = self.lens - si.p
        inverse_square = dr.rcp(dr.squared_norm(to_lens))
        wo = si.to_local(to_lens * dr.sqrt(inverse_square))
        lit = hit & in_field & (wo.z > 0) & (si.wi.z > 0)
        lit &= ~self.world.ray_test(si.spawn_ray_to(self.lens), lit)
        value = dr.select(lit, bsdf.eval(self.context, si, wo, lit), 0)
        seen = p.throughput * value * (self.intensity_w_sr * inverse_square)
        seen *= self.weights
        p.white += seen
        mono = dr.sum(seen)
        if self.footprint:
            pixels = self._footprint(p, si, place, focal_px)
        else:
            pixels = [_pixel_index(self.projector, place)]
        self._add_levels(p, mono, pixels, lit)

    def _footprint(self, p: _Paths, si, place: mi.Point2f, focal_px: mi.Float) -> list[mi.UInt32]:
        """Projector pixels spread over the disk for which this vertex stands."""
        grown = si.t * dr.sqrt(dr.inv_pi / (self.quality.samples * p.last_pdf))
        p.spread = dr.select(p.vertex == 0, 0, p.spread + dr.select(p.last_pdf > 0, grown, 0))
        start = p.rng.next_float32()
        sine, cosine = dr.sincos(dr.two_pi * p.rng.next_float32())
        pixels = []
        for j in range(FOOTPRINT_LOOKUPS):
            # Equal areas of the disk in turn, and equal angles, from a random start of both.
            area = start + j * R2[0]
            radius_px = p.spread * focal_px * dr.sqrt(area - dr.floor(area))
            angle = 2 * math.pi * j / FOOTPRINT_LOOKUPS
            c, s = math.cos(angle), math.sin(angle)
            aside = mi.Vector2f(c * cosine - s * sine, s * cosine + c * sine)
            beside = mi.Point2f(place + radius_px * aside)
            pixels.append(_pixel_index(self.projector, beside))
        return pixels

    def _add_levels(self, p: _Paths, mono: mi.Float, pixels: list[mi.UInt32], lit: mi.Bool) -> None:
        """To each pattern its mean level over the pixels."""
        per_word = 32 // self.bits_each
        for first in range(0, self.pattern_count, per_word):
            words = self.words[first // per_word]
            levels = [dr.gather(mi.UInt32, words, pixel, lit) for pixel in pixels]
            shifts = range(
                0, min(per_word, self.pattern_count - first) * self.bits_each, self.bits_each
            )
            if self.bits_each == 1:
                planes = _bit_counts(levels)
                shares = [mono * (2**i / len(pixels)) for i in range(len(planes))]
                for k, shift in enumerate(shifts, start=first):
                    for plane, share in zip(planes, shares, strict=True):
                        p.pattern[k] += dr.select((plane & (1 << shift)) != 0, share, 0)
            else:
                share = mono / (255 * len(pixels))
                for k, shift in enumerate(shifts, start=first):
                    total = sum((level >> shift) & 255 for level in levels)
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


def _bit_counts(words: list[mi.UInt32]) -> list[mi.UInt32]:
    """How many of seven words have each bit set, as the three bits of that count; of one, itself.

    Four full adders count all 32 bits at once, so that a pattern costs three additions, not seven.
    """

    def add(a: mi.UInt32, b: mi.UInt32, c: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        return a ^ b ^ c, (a & b) | (c & (a ^ b))

    if len(words) == 1:
        return words
    a, b, c, d, e, f, g = words
    low_1, carry_1 = add(a, b, c)
    low_2, carry_2 = add(d, e, f)
    ones, carry_3 = add(low_1, low_2, g)
    twos, fours = add(carry_1, carry_2, carry_3)
    return [ones, twos, fours]


def _power_heuristic(a: mi.Float, b: mi.Float) -> mi.Float:
    """Weight of technique a against b (E. Veach, 1997, power 2); 0 where a cannot occur."""
    return dr.select(a > 0, dr.square(a) / dr.fma(a, a, dr.square(b)), 0)


def _camera_ray(camera: Optics, x: mi.Float, y: mi.Float) -> mi.Vector3f:
    """Unit direction of a pixel position, camera frame, distortion taken off by Newton steps."""
    xd, yd = (x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px
    xi, yi = mi.Float(xd), mi.Float(yd)
    if camera.has_distortion:
        k1, k2, p1, p2, k3 = camera.distortion
        for _ in range(NEWTON_STEPS):
            r2 = xi * xi + yi * yi
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
            a = radial + slope * xi * xi + 2 * p1 * yi + 6 * p2 * xi
            b = slope * xi * yi + 2 * p1 * xi + 2 * p2 * yi
            d = radial + slope * yi * yi + 6 * p1 * yi + 2 * p2 * xi
            fx, fy = _distorted(xi, yi, camera.distortion)
            ex, ey = fx - xd, fy - yd
            scale = dr.rcp(a * d - b * b)
            xi, yi = xi - (d * ex - b * ey) * scale, yi - (a * ey - b * ex) * scale
    return dr.normalize(mi.Vector3f(xi, yi, 1))


def _distorted(x, y, distortion):
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _projector_place(
    projector: Optics, T_proj_world: mi.Matrix4f, p: mi.Point3f
) -> tuple[mi.Point2f, mi.Float, mi.Bool]:
    """Where the projector sees a world point [px], pixels per metre there, and if at all."""
    q = T_proj_world @ mi.Vector4f(p.x, p.y, p.z, 1)
    ahead = q.z > 0
    scale = dr.select(ahead, dr.rcp(q.z), 0)
    x, y = q.x * scale, q.y * scale
    if projector.has_distortion:
        ahead &= x * x + y * y < fold_radius2(projector.distortion)
        x, y = _distorted(x, y, projector.distortion)
    u = dr.fma(x, projector.fx_px, projector.cx_px)
    v = dr.fma(y, projector.fy_px, projector.cy_px)
    inside = ahead & (u >= -0.5) & (u < projector.width_px - 0.5)
    inside &= (v >= -0.5) & (v < projector.height_px - 0.5)
    return mi.Point2f(u, v), projector.fx_px * scale, inside


def _pixel_index(projector: Optics, place: mi.Point2f) -> mi.UInt32:
    """The pixel at a place; a pixel is a square around its centre, so the nearest centre is it."""
    u = dr.clip(dr.floor(place.x + 0.5), 0, projector.width_px - 1)
    v = dr.clip(dr.floor(place.y + 0.5), 0, projector.height_px - 1)
    return mi.UInt32(v * projector.width_px + u)  # exact below 2^24 pixels


# --- geometry --------------------------------------------------------------------------------


def truth(
    world: mi.Scene, part_shapes: tuple[PartShape, ...], scene: Scene, layout: Layout
) -> GroundTruth:
    camera = scene.rig.camera
    h, w = camera.height_px, camera.width_px
    boxes = [_silhouette_box(scene, layout, i) for i in range(len(layout.part_index))]
    ray = _centre_rays(scene, left=0, top=0, width=w, height=h)
    si = world.ray_intersect(ray)
    hit = si.is_valid()
    R_cam_world = mi.Matrix3f(scene.T_world_cam[:3, :3].T)
    axis = mi.Vector3f(scene.T_world_cam[:3, 2])
    depth = dr.select(hit, si.t * dr.dot(ray.d, axis), dr.nan)
    n = dr.select(hit, R_cam_world @ si.n, dr.nan)
    n = dr.mulsign(n, -dr.dot(si.n, ray.d))
    instance = _instance(si, part_shapes)
    dr.eval(depth, n, instance)
    bits, left, top = _amodal_bits(part_shapes, scene, boxes)
    return GroundTruth(
        depth_m=np.array(depth).reshape(h, w),
        normal=np.array(n).T.reshape(h, w, 3),
        instance=np.array(instance).reshape(h, w),
        amodal=tuple(_silhouette(bits, left, top, i, box) for i, box in enumerate(boxes)),
    )


def _centre_rays(scene: Scene, *, left: int, top: int, width: int, height: int) -> mi.Ray3f:
    """Rays through the pixel centres of a canvas whose first pixel is (left, top)."""
    camera = scene.rig.camera
    x, y = _canvas(left=left, top=top, width=width, height=height)
    direction = mi.Matrix3f(scene.T_world_cam[:3, :3]) @ _camera_ray(camera, x, y)
    return mi.Ray3f(mi.Point3f(scene.T_world_cam[:3, 3]), direction)


def _canvas(*, left: int, top: int, width: int, height: int) -> tuple[mi.Float, mi.Float]:
    """Pixel positions; the corner and width, other in each scene, stay out of the kernel's text."""
    lane = dr.arange(mi.Int32, width * height)
    columns = dr.opaque(mi.Int32, width)
    x = lane % columns + dr.opaque(mi.Int32, left)
    return mi.Float(x), mi.Float(lane // columns + dr.opaque(mi.Int32, top))


def _instance(si: mi.SurfaceInteraction3f, part_shapes: tuple[PartShape, ...]) -> mi.Int32:
    """Layout index of what was hit; -1 for anything but a part."""
    instance = dr.full(mi.Int32, -1, dr.width(si))
    for part in part_shapes:
        table = mi.Int32(part.instances.astype(np.int32))
        mine = si.is_valid() & (si.shape == mi.ShapePtr(part.shape))
        index = dr.gather(mi.Int32, table, si.prim_index // part.faces_each, mine)
        instance = dr.select(mine, index, instance)
    return instance


def _silhouette_box(scene: Scene, layout: Layout, index: int) -> tuple[int, int, int, int]:
    """Pixels (left, top, right, bottom; ends excluded) that can meet an instance.

    Reaches at most one image size beyond each border.
    """
    camera = scene.rig.camera
    part = scene.parts[layout.part_index[index]]
    T_cam_part = inverse(scene.T_world_cam) @ layout.T_world_part[index]
    pixel = project(camera, _outline(transform_points(T_cam_part, part.mesh.vertices_m)))
    size = np.array([camera.width_px, camera.height_px])
    if np.isnan(pixel).any():  # reaches behind the lens: it may be anywhere
        low, high = -size, 2 * size
    else:
        # A pixel of slack: distortion bends the outline between its points.
        low = np.clip(np.floor(pixel.min(axis=0)).astype(int) - 1, -size, 2 * size)
        high = np.clip(np.ceil(pixel.max(axis=0)).astype(int) + 2, -size, 2 * size)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _outline(point: np.ndarray) -> np.ndarray:
    """Points around the image of others in an ideal lens; a real one maps their curve around it."""
    if (point[:, 2] <= 0).any():
        return point
    ideal = point[:, :2] / point[:, 2:]
    low, high = ideal.min(axis=0), ideal.max(axis=0)
    step = np.linspace(0.0, 1.0, OUTLINE_POINTS)
    along = np.concatenate([step, step, 0 * step, 0 * step + 1])
    across = np.concatenate([0 * step, 0 * step + 1, step, step])
    border = low + (high - low) * np.stack([along, across], axis=-1)
    return np.concatenate([border, np.ones_like(border[:, :1])], axis=-1)


def _amodal_bits(
    part_shapes: tuple[PartShape, ...],
    scene: Scene,
    boxes: list[tuple[int, int, int, int]],
) -> tuple[np.ndarray, int, int]:
    """One bit per instance and pixel, uint32 (words, rows, columns), and the canvas's first pixel.

    Follows each centre ray through all parts it meets, so hidden surfaces count as well. The bin
    is left out: a part that lies flat on it would share its depth.
    """
    if not boxes:
        return np.zeros((0, 0, 0), dtype=np.uint32), 0, 0
    box = np.array(boxes)
    left, top = (int(e) for e in box[:, :2].min(axis=0))
    width, height = (int(e) for e in box[:, 2:].max(axis=0) - [left, top])
    if width <= 0 or height <= 0:  # no part comes near the picture
        return np.zeros(((len(boxes) + 31) // 32, 0, 0), dtype=np.uint32), left, top
    ray = _centre_rays(scene, left=left, top=top, width=width, height=height)
    going = _exists(scene, ray, *_canvas(left=left, top=top, width=width, height=height))
    parts_alone = {f"part{i}": part.shape for i, part in enumerate(part_shapes)}
    world = mi.load_dict({"type": "scene"} | parts_alone)
    words = _follow(world, part_shapes, ray, going, (len(boxes) + 31) // 32)
    dr.eval(words)
    return np.stack([np.array(word).reshape(height, width) for word in words]), left, top


def _exists(scene: Scene, ray: mi.Ray3f, x: mi.Float, y: mi.Float) -> mi.Bool:
    """Whether the ray of a pixel goes back to it: beyond the fold of a lens there is none."""
    camera = scene.rig.camera
    if not camera.has_distortion:
        return dr.full(mi.Bool, True, dr.width(ray.d))
    d = mi.Matrix3f(scene.T_world_cam[:3, :3].T) @ ray.d
    xi, yi = d.x / d.z, d.y / d.z
    u, v = _distorted(xi, yi, camera.distortion)
    returns = dr.abs(dr.fma(u, camera.fx_px, camera.cx_px) - x) < 0.05
    returns &= dr.abs(dr.fma(v, camera.fy_px, camera.cy_px) - y) < 0.05
    return returns & (xi * xi + yi * yi < fold_radius2(camera.distortion))


def _follow(
    world: mi.Scene,
    part_shapes: tuple[PartShape, ...],
    ray: mi.Ray3f,
    going: mi.Bool,
    word_count: int,
) -> list[mi.UInt32]:
    """The instances that each ray meets on its whole way, as a set of bits."""

    def body(origin, going, words):
        si = world.ray_intersect(
            mi.Ray3f(origin, ray.d), mi.RayFlags.Minimal, coherent=True, active=going
        )
        instance = _instance(si, part_shapes)
        bit = mi.UInt32(1) << mi.UInt32(instance & 31)
        words = [
            word | dr.select((instance >= 0) & (instance >> 5 == k), bit, 0)
            for k, word in enumerate(words)
        ]
        # Not `spawn_ray`: it steps along the normal and would leave the pixel's ray.
        return mi.Point3f(origin + (si.t + STEP_THROUGH_M) * ray.d), si.is_valid(), words

    none = [dr.zeros(mi.UInt32, dr.width(ray.d)) for _ in range(word_count)]
    _, _, words = dr.while_loop(
        state=(mi.Point3f(ray.o), going, none), cond=lambda o, going, w: going, body=body
    )
    return words


def _silhouette(
    bits: np.ndarray, left: int, top: int, index: int, box: tuple[int, int, int, int]
) -> Silhouette:
    x0, y0, x1, y1 = box
    word = bits[index // 32, y0 - top : y1 - top, x0 - left : x1 - left]
    mask = (word >> np.uint32(index % 32)) & np.uint32(1) == 1
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return Silhouette(left_px=x0, top_px=y0, mask=np.zeros((0, 0), dtype=bool))
    mask = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return Silhouette(left_px=x0 + int(columns[0]), top_px=y0 + int(rows[0]), mask=mask.copy())
