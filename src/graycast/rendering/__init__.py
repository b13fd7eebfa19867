"""Light transport: one file or folder per back end, and a small exact reference.

`mitsuba.py` and what it imports load Mitsuba, so they are imported after `open_device` has set its
variant.

Each imports only from those above it:

    ggx                the distribution of microfacets of all rough materials
    radiance           what a renderer returns, and the protocol `Renderer`
    wavelength         the scene in the light of the projector's wavelength
    trial              a small picture, rendered by a process that a broken driver may end
    dielectric         clear glass and plastic
    mitsuba_patterns   patterns in few bits, and sums over them
    mitsuba_lens       lenses in Dr.Jit
    coated_diffuse     plastic and paint: a clear coat over a diffuse base
    rough_conductor    metal, also brushed or turned
    denoise            denoising by Open Image Denoise
    path_noise         the error that a finite number of light paths leaves in a pixel
    device             which render devices work, and how one is opened
    mitsuba_sight      what rays meet where there may be glass
    mitsuba_projector  the projector as a light
    filmed_conductor   metal under oil or lacquer
    reference          planes and spheres in direct light, exact, in NumPy
    cycles             Blender Cycles in a process of its own, a render for each pattern
    mitsuba_scene      a scene as Mitsuba has it: materials, meshes, lights
    mitsuba_stage      what all light paths through a scene share
    mitsuba_caustics   light paths from the projector over shiny surfaces: caustics
    mitsuba_truth      depth, normals and silhouettes at pixel centres
    mitsuba_paths      light paths from the camera, for all patterns at once
    mitsuba            the renderer of one pass for all patterns
    trial_picture      the process of `trial`
"""

import numpy as np
from jaxtyping import UInt8

from ..world.scene import Layout, Scene
from .radiance import (
    Denoiser,
    DenoiserName,
    GroundTruth,
    OnFrame,
    OnPass,
    PathNoise,
    Quality,
    Radiance,
    Renderer,
    Rendering,
    Silhouette,
)

__all__ = [
    "Denoiser",
    "DenoiserName",
    "GroundTruth",
    "OnFrame",
    "OnPass",
    "PathNoise",
    "Quality",
    "Radiance",
    "Renderer",
    "Rendering",
    "Silhouette",
    "choose_device",
    "open_renderer",
    "render",
]


def open_renderer(
    name: str = "mitsuba",
    *,
    device: str = "auto",
    threads: int | None = None,
    patterns_per_render: int = 1,
    on_frame: OnFrame | None = None,
    on_pass: OnPass | None = None,
) -> Renderer:
    """Open a renderer by its name; each back end is imported only when it is opened.

    Args:
        name: 'mitsuba' renders all patterns in one pass, 'cycles' each by itself in Blender,
            'reference' direct light on simple surfaces, exactly.
        device: 'auto', 'cpu', 'cuda' or, of Cycles, 'optix'. A process has one device of Mitsuba.
        threads: processor threads; None leaves the choice to the back end.
        patterns_per_render: of Cycles: 3 puts patterns into R, G and B, where light is of one
            wavelength or all materials are grey.
        on_frame: of Cycles, which may take minutes for a scene: called after each render.
        on_pass: of Mitsuba: called after every few samples of a stack; an exception in it ends
            the rendering.

    Raises:
        DeviceError: the back end or the device is not there; the text ends with the remedy.
        ValueError: no such back end or device.
    """
    match name:
        case "reference":
            from .reference import ReferenceRenderer

            return ReferenceRenderer()
        case "mitsuba":
            from .device import choose_device, open_device

            device = choose_device(device)
            open_device(device, threads=threads)
            from .mitsuba import MitsubaRenderer

            return MitsubaRenderer(device, on_pass=on_pass)
        case "cycles":
            from .cycles.renderer import CyclesRenderer

            return CyclesRenderer(
                device=device,
                threads=threads,
                patterns_per_render=patterns_per_render,
                on_frame=on_frame,
            )
    raise ValueError(
        f"the renderer {name!r} does not exist: choose 'mitsuba', 'cycles' or 'reference'"
    )


def render(
    scene: Scene,
    layout: Layout,
    patterns: UInt8[np.ndarray, "n ph pw"],
    *,
    quality: Quality | None = None,
    seed: int,
    device: str = "auto",
) -> Rendering:
    """Render one scene under a stack of patterns, with Mitsuba; see `Renderer.render`.

    For more than one scene, keep a renderer open with `open_renderer`.

    Raises:
        DeviceError, ValueError: as of `open_renderer` and `Renderer.render`.
    """
    with open_renderer(device=device) as renderer:
        return renderer.render(scene, layout, patterns, quality=quality or Quality(), seed=seed)


def choose_device(backend: str, name: str) -> str:
    """The device on which a back end would render; takes 'auto', returns what is there.

    Raises:
        DeviceError: the back end or the device is not there; the text ends with the remedy.
        ValueError: no such device of this back end.
    """
    if backend == "cycles":
        from .cycles import examine_cycles
        from .cycles.renderer import choose_cycles_device

        return choose_cycles_device(name, examine_cycles())
    from .device import choose_device as choose

    return choose(name)
