"""Write your own renderer: fog between camera, projector and parts, added to another renderer.

Any object with the methods of `graycast.Renderer` can make scenes. This renderer gets light from
another renderer, and attenuates it on its way from the projector to a surface and back to the
camera: `exp(-density * (length of both ways))`, the law of Beer and Lambert.

Leaves out: light that the fog scatters into the camera, and fog between surfaces.

Run: .venv/bin/python examples/06_own_renderer.py
"""

import sys
from dataclasses import replace
from typing import final

import numpy as np

import graycast
from graycast.base.frames import inverse, pixel_grid, transform_points
from graycast.rig.optics import rays


@final
class FoggyRenderer(graycast.Renderer):
    """Another renderer's light after it has passed through fog of a density [1/m]."""

    def __init__(self, clear: graycast.Renderer, density_per_m: float) -> None:
        self.clear, self.density_per_m = clear, density_per_m
        self.name, self.device = f"{clear.name} in fog", clear.device
        self.denoiser = clear.denoiser
        self.versions = clear.versions

    def render(self, scene, layout, pattern, *, quality, seed) -> graycast.Rendering:
        rendering = self.clear.render(scene, layout, pattern, quality=quality, seed=seed)
        rig, depth_m = scene.rig, rendering.truth.depth_m
        grid = pixel_grid(rig.camera.height_px, rig.camera.width_px)
        point_m = rays(rig.camera, grid) * np.nan_to_num(depth_m)[..., None]
        from_camera_m = np.linalg.norm(point_m, axis=-1)
        in_projector_m = transform_points(inverse(rig.T_cam_proj), point_m)
        view = np.exp(-self.density_per_m * from_camera_m).astype(np.float32)
        light = view * np.exp(-self.density_per_m * np.linalg.norm(in_projector_m, axis=-1))
        light = light.astype(np.float32)
        radiance = replace(
            rendering.radiance,
            pattern=rendering.radiance.pattern * light,
            white=rendering.radiance.white * light,
            white_rgb=rendering.radiance.white_rgb * light[..., None],
            ambient=rendering.radiance.ambient * view,
            ambient_rgb=rendering.radiance.ambient_rgb * view[..., None],
        )
        return replace(rendering, radiance=radiance)


def main(samples: int) -> None:
    config = graycast.Config(
        parts=(graycast.PartSection(builtin="toothpaste"),),
        count=5,
        rig="like-phoxi-m",
        resolution="small",
        render=graycast.RenderSection(samples=samples),
    )
    cell = graycast.load_cell(config)
    with graycast.open_cell_renderer(cell) as clear:
        for density_per_m in (0.0, 0.5, 1.0):
            foggy = FoggyRenderer(clear, density_per_m)
            shot = graycast.make_scene(cell, 0, seed=1, renderer=foggy)
            decoded = np.isfinite(shot.sample.scanner_depth.depth_m).mean()
            exposure_ms = 1000 * np.max(shot.capture.exposure_s)
            print(f"density {density_per_m:3.1f} /m: {exposure_ms:6.3f} ms, {decoded:6.1%} decoded")


if __name__ == "__main__":
    main(samples=int(sys.argv[1]) if len(sys.argv) > 1 else 16)
