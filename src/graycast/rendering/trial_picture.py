"""The child process of `trial`: renders and denoises a small picture, and prints the denoiser.

python -m graycast.rendering.trial_picture DEVICE
"""

import json
import sys
from dataclasses import replace

import numpy as np

from ..rig.optics import Optics
from ..rig.pair import preset_rig
from ..world.parts import Material
from ..world.scene import EMPTY_LAYOUT, Quad, Scene
from .denoise import OpenImageDenoise, denoise
from .device import open_device
from .radiance import Quality

CAMERA = Optics(width_px=64, height_px=48, fx_px=70.0, fy_px=70.0, cx_px=31.5, cy_px=23.5)


def _main(device: str) -> None:
    open_device(device)
    from .mitsuba.renderer import MitsubaRenderer

    rig = replace(preset_rig("paper"), camera=CAMERA)
    wall = Quad(
        center_m=(0.0, 0.0, 0.7),
        half_u_m=(1.0, 0.0, 0.0),
        half_v_m=(0.0, -1.0, 0.0),  # The front of the wall faces the camera.
        material=Material(base_color=(0.5, 0.5, 0.5)),
    )
    scene = Scene(rig=rig, T_world_cam=np.eye(4), surfaces=(wall,))
    white = np.full((1, rig.projector.height_px, rig.projector.width_px), 255, dtype=np.uint8)
    with MitsubaRenderer(device) as renderer:
        rendering = renderer.render(scene, EMPTY_LAYOUT, white, quality=Quality(samples=4), seed=0)
        light = rendering.radiance
        clean = denoise(light.white_rgb, light.albedo, rendering.truth.normal, renderer.denoiser)
        if not (np.isfinite(clean).all() and clean.mean() > 0):
            raise RuntimeError(f"the picture of a lit wall is dark: its mean is {clean.mean()}")
        if not isinstance(renderer.denoiser, OpenImageDenoise):
            raise RuntimeError("the renderer has another denoiser")
        print(json.dumps({"denoiser": renderer.denoiser.device}))


if __name__ == "__main__":
    _main(sys.argv[1])
