"""Light transport: one file or folder for each back end, and a small exact reference.

The modules in `bsdf` and `mitsuba` load Mitsuba, so they are imported only after `open_device` has
set Mitsuba's variant.

Each module imports only from the modules above it:

    radiance       a renderer's results, and the protocol `Renderer`
    wavelength     the scene in light with the projector's wavelength
    trial          a small picture, rendered in a process that a broken driver may crash
    bsdf           materials of Mitsuba
    denoise        denoising by Open Image Denoise
    path_noise     the error of a pixel from a finite number of light paths
    device         finds the render devices that work, and opens a device
    reference      planes and spheres in direct light, exact, in NumPy
    cycles         Blender Cycles in a separate process, with a render for each pattern
    mitsuba        Mitsuba 3, with one pass of light paths for all patterns
    trial_picture  the process of `trial`
"""

from ..base import array_types as arrays
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
        name: 'mitsuba' renders all patterns in one pass, 'cycles' renders each pattern separately
            in Blender, 'reference' computes exact direct light on simple surfaces.
        device: 'auto', 'cpu', 'cuda' or, for Cycles, 'optix'. Mitsuba has one device per process.
        threads: processor threads; None leaves the choice to the back end.
        patterns_per_render: for Cycles: 3 renders patterns as R, G and B, if light has only one
            wavelength or all materials are grey.
        on_frame: for Cycles, which may take minutes for a scene: called after each render.
        on_pass: for Mitsuba: called after every few samples of a stack; an exception in it ends
            the rendering.

    Raises:
        DeviceError: the back end or device is not available; the message ends with the remedy.
        ValueError: there is no such back end or device.
    """
    match name:
        case "reference":
            from .reference import ReferenceRenderer

            return ReferenceRenderer()
        case "mitsuba":
            from .device import choose_device, open_device

            device = choose_device(device)
            open_device(device, threads=threads)
            from .mitsuba.renderer import MitsubaRenderer

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
    patterns: arrays.UInt8Array_n_ph_pw,
    *,
    quality: Quality | None = None,
    seed: int,
    device: str = "auto",
) -> Rendering:
    """Render one scene under a stack of patterns with Mitsuba; see `Renderer.render`.

    For several scenes, open one renderer with `open_renderer` and use it again.

    Raises:
        DeviceError, ValueError: see `open_renderer` and `Renderer.render`.
    """
    with open_renderer(device=device) as renderer:
        return renderer.render(scene, layout, patterns, quality=quality or Quality(), seed=seed)


def choose_device(backend: str, name: str) -> str:
    """Return the device on which a back end would render; 'auto' becomes an available device.

    Raises:
        DeviceError: the back end or device is not available; the message ends with the remedy.
        ValueError: the back end has no such device.
    """
    if backend == "cycles":
        from .cycles import examine_cycles
        from .cycles.renderer import choose_cycles_device

        return choose_cycles_device(name, examine_cycles())
    from .device import choose_device as choose

    return choose(name)
