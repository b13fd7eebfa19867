"""The one-pass renderer: every projected pattern from one set of light paths, by Mitsuba 3.

Light transport is linear in the projector's picture, and the scene does not move. So each path from
the camera is traced only once. At each vertex, the direct light of the projector is added to the
sum of every pattern, multiplied by the level of that pattern at the projector pixel which sees the
vertex. All patterns share the same paths and thus the same Monte Carlo error: it acts as if the
picture were taken through slightly different pixels, and does not differ from bit to bit. Only
sensor noise, which is added later, differs.

In a rough reflection, one of n samples represents a cone of directions, and its end represents a
patch of surface and not a point of one stripe. So indirect light uses the mean level of the
patterns over this patch (`Quality.footprint`), as ray cones filter textures. The patch shrinks with
the number of samples, so the estimate is consistent. The white frame does not change, and stripes
in a rough reflection are blurred, as they are in the limit, and do not sparkle.

Both lenses are thin (`Optics`). Paths start at random points of the camera's pupil. The projector
lights a point with a disc of its picture, so the mean level over that disc is used, too. A pixel's
samples are pairs of opposite positions, so a smooth surface is seen at the exact pixel centre.

For projector light on shiny surfaces, more paths start at the projector (`caustics.py`).

Limits: the only transparent material is glass (`sight.py`); light over two polished
surfaces is noisy. The shadow ray goes to a random point of the projector's lens, but patterns are
averaged over the whole lens: penumbras have the right softness, but their stripes lack the shift
from the hidden half of the lens.
"""

from dataclasses import fields, replace
from importlib.metadata import version
from operator import is_
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from ...rig.optics import relative_illumination
from ...world.scene import Layout, Scene
from ..denoise import denoised, open_denoiser
from ..path_noise import path_noise
from ..radiance import (
    Denoiser,
    OnPass,
    PathNoise,
    Patterns,
    Quality,
    Radiance,
    Renderer,
    Rendering,
    refuse_other_size,
)
from ..wavelength import at_projector_wavelength
from .caustics import CausticTracer
from .paths import Paths, Tracer
from .patterns import aligned
from .projector import ShinyField
from .scene import MitsubaWorld, build
from .stage import Stage
from .truth import centre_places, truth


@final
class MitsubaRenderer(Renderer):
    """Renderer that traces each light path once for all patterns, with Mitsuba 3.

    The last Mitsuba scene is kept, and is reused for images of the same scene by other rigs or from
    other poses. `close` releases the scene but not the device: a process cannot change its device.
    """

    name = "mitsuba"

    def __init__(self, device: str, *, on_pass: OnPass | None = None):
        self.device, self._on_pass = device, on_pass
        self._built_of: tuple[object, ...] = ()
        self._worlds: tuple[MitsubaWorld, MitsubaWorld] | None = None
        self.denoiser: Denoiser = open_denoiser(device)
        self.versions = {name: version(name) for name in ("mitsuba", "drjit")}

    def render(
        self, scene: Scene, layout: Layout, pattern: Patterns, *, quality: Quality, seed: int
    ) -> Rendering:
        refuse_other_size(pattern, scene.rig.projector)
        if quality.denoise == "optix":
            raise ValueError("denoise optix exists only for Cycles: choose none or oidn")
        # Dr.Jit keeps free blocks of the last scene, which accumulate unless they fit this one.
        dr.flush_malloc_cache()
        measured = at_projector_wavelength(scene)
        world, look_world = self._open_worlds(scene, measured, layout)
        radiance = light(
            world, measured, pattern, quality=quality, seed=seed, on_pass=self._on_pass
        )
        if measured is not scene:
            look = light(look_world, scene, pattern[:0], quality=quality, seed=seed)
            radiance = replace(
                radiance,
                white_rgb=look.white_rgb,
                ambient_rgb=look.ambient_rgb,
                albedo=look.albedo,
            )
        ground_truth = truth(world.scene, world.part_shapes, scene, layout)
        if quality.denoise != "none":
            radiance = denoised(radiance, ground_truth.normal, self.denoiser)
        return Rendering(radiance=radiance, truth=ground_truth)

    def close(self) -> None:
        self._built_of, self._worlds = (), None

    def _open_worlds(
        self, scene: Scene, measured: Scene, layout: Layout
    ) -> tuple[MitsubaWorld, MitsubaWorld]:
        """Return the worlds for measuring and for the colour picture; reuse the last ones."""
        rest = [f.name for f in fields(Scene) if f.name not in ("rig", "T_world_cam")]
        built_of = layout, *(getattr(scene, name) for name in rest)
        if self._worlds is None or not all(map(is_, built_of, self._built_of)):
            self.close()  # The old and the new world may not fit into memory together.
            world = build(measured, layout)
            self._worlds = world, world if measured is scene else build(scene, layout)
            self._built_of = built_of
        return self._worlds


def light(
    world: MitsubaWorld,
    scene: Scene,
    pattern: np.ndarray,
    *,
    quality: Quality,
    seed: int,
    on_pass: OnPass | None = None,
) -> Radiance:
    camera = scene.rig.camera
    h, w = camera.height_px, camera.width_px
    stage = Stage(world, scene, pattern, quality)
    field = _shiny_field(stage, world.shiny)
    caustics = CausticTracer(stage, field).trace(seed) if field is not None else None
    paths = Tracer(stage, field).trace(seed, on_pass)
    if caustics is not None:
        paths.add(caustics)

    # The kernel of the paths also scales and arranges the sums, on all of its threads.
    falloff = relative_illumination(camera) / quality.samples
    share = mi.Float(aligned(falloff.astype(np.float32)))
    white, ambient = paths.white * share, paths.ambient * share
    passed = mi.Color3f(scene.rig.passed_bands)
    stack = dr.ravel(mi.ArrayXf([channel * share for channel in paths.pattern]), "C")
    gray = dr.sum(white), dr.dot(ambient, passed)
    color = dr.ravel(white), dr.ravel(ambient), dr.ravel(paths.albedo / quality.samples)
    # Evaluate all results at once, because a later evaluation would trace the paths again.
    place = paths.placed / paths.straight
    dr.eval(stack, gray, color, place, paths.straight, paths.stray, paths.stray2)

    white_rgb, ambient_rgb, albedo = (channels.numpy().reshape(h, w, 3) for channels in color)
    return Radiance(
        pattern=stack.numpy().reshape(len(pattern), h, w),
        white=gray[0].numpy().reshape(h, w),
        ambient=gray[1].numpy().reshape(h, w),
        white_rgb=white_rgb,
        ambient_rgb=ambient_rgb,
        albedo=albedo,
        path_noise=_path_noise(stage, paths, place, scene) if stage.finest else None,
        place_px=place.numpy().reshape(2, h, w) if len(pattern) else None,
    )


def _shiny_field(stage: Stage, shiny: tuple[mi.Shape, ...]) -> ShinyField | None:
    """Return the shiny field of the projector's picture; None if no light goes on from there."""
    if not shiny or stage.quality.depth == 1:
        return None
    field = ShinyField(stage.world, stage.light, shiny, stage.pixels)
    return field if field.count else None


def _path_noise(stage: Stage, paths: Paths, mean: mi.Point2f, scene: Scene) -> PathNoise:
    size = scene.rig.camera.height_px, scene.rig.camera.width_px
    centre = centre_places(stage, scene)
    samples = stage.quality.samples
    stray2 = {
        axis: _variance(paths.stray[axis], paths.stray2[axis], samples) for axis in paths.stray
    }
    dr.eval(centre, stray2)
    places = {"column": (mean.x, centre.x), "row": (mean.y, centre.y)}
    return path_noise(
        {
            axis: (places[axis][0].numpy().reshape(size), places[axis][1].numpy().reshape(size))
            for axis in stage.finest
        },
        paths.straight.numpy().reshape(size),
        {axis: variance.numpy().reshape(size) for axis, variance in stray2.items()},
        samples=samples,
    )


def _variance(total: mi.Float, squares: mi.Float, samples: int) -> mi.Float:
    """Return the variance of a sum of independent samples; for a single sample, its square."""
    if samples == 1:
        return squares
    return dr.maximum(squares - dr.square(total) / samples, 0) * (samples / (samples - 1))
