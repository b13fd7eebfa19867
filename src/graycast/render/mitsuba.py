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

from dataclasses import replace
from importlib.metadata import version
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics import relative_illumination
from ..scene import Layout, Scene
from .denoise import denoised
from .mitsuba_paths import Tracer
from .mitsuba_scene import build
from .mitsuba_truth import truth
from .radiance import Denoiser, OnPass, Quality, Radiance, Renderer, Rendering, refuse_other_size
from .wavelength import at_projector_wavelength


@final
class MitsubaRenderer(Renderer):
    """See the module. Each call builds and releases its scene; the process keeps the device."""

    name = "mitsuba"

    def __init__(self, device: str, *, on_pass: OnPass | None = None):
        self.device, self._on_pass = device, on_pass
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
        refuse_other_size(pattern, scene.rig.projector)
        # Blocks that Dr.Jit keeps from the last scene: not all fit this one, so they would add up.
        dr.flush_malloc_cache()
        measured = at_projector_wavelength(scene)
        world, part_shapes = build(measured, layout)
        radiance = light(
            world, measured, pattern, quality=quality, seed=seed, on_pass=self._on_pass
        )
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


def light(
    world: mi.Scene,
    scene: Scene,
    pattern: np.ndarray,
    *,
    quality: Quality,
    seed: int,
    on_pass: OnPass | None = None,
) -> Radiance:
    camera = scene.rig.camera
    h, w = camera.height_px, camera.width_px
    paths = Tracer(world, scene, pattern, quality).trace(seed, on_pass)
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
