"""Ratio of actual to stated depth errors of simulated scans, by code and number of light paths."""

from dataclasses import replace

import numpy as np

from graycast.base.tables import markdown_table
from graycast.camera.decode import FilterSpec
from graycast.camera.scanner import Scanner, preset, scan
from graycast.rendering import Quality, Radiance, Renderer, Rendering, open_renderer
from graycast.rig.pattern import CodeSpec
from graycast.rig.pattern.spec import Codec
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Quad, Scene

from .cells import cropped
from .figures import Show

CODECS: tuple[Codec, ...] = ("gray", "gray_phase", "multi_frequency", "micro_phase")
SAMPLES = (1, 2, 4, 16, 64)
SIZE_PX = (160, 120)
DISTANCE_M, HALF_M = 0.75, 0.4
WITHIN = 0.6827  # share of normally distributed errors within one sigma
GROSS = 5.0  # A gross error is more than this many sigmas.
WHITE = Material(base_color=(0.8, 0.8, 0.8), specular=0.0)


def honesty(show: Show) -> str:
    """Return Markdown tables of error over sigma, without -> with the renderer's noise in sigma."""
    renderer = open_renderer("mitsuba")
    texts = []
    for name, scanner in _scanners().items():
        for scene, quality in ((_wall(scanner), Quality(depth=1)), (_valley(scanner), Quality())):
            kind = "two facing walls" if len(scene.surfaces) > 1 else "a leaning wall"
            rows = []
            for codec in CODECS:
                own = replace(scanner, code=CodeSpec(codec=codec, axes=("column",)))
                show(f"{name}, {kind}, {codec}")
                cells = [
                    _cell(renderer, own, scene, replace(quality, samples=samples))
                    for samples in SAMPLES
                ]
                rows.append([f"`{codec}`", *cells])
            texts.append(markdown_table([f"{name}, {kind}", *map(str, SAMPLES)], rows))
    return "\n\n".join(texts)


def _cell(renderer: Renderer, scanner: Scanner, scene: Scene, quality: Quality) -> str:
    """Return error over sigma without -> with the renderer's noise, and gross errors with it."""
    code = scanner.light_code()
    # Codes without phases give equal columns in two renderings, and interreflection changes few.
    seeds = (1, 2) if quality.depth > 1 and code.subpixel else (1,)
    shots = [
        renderer.render(scene, EMPTY_LAYOUT, code.render(), quality=quality, seed=seed)
        for seed in seeds
    ]
    without = [replace(shot.radiance, path_noise=None) for shot in shots]
    before = _error_sigmas(scanner, shots, without)
    after = _error_sigmas(scanner, shots, [shot.radiance for shot in shots])
    gross = f", {np.mean(after > GROSS):.1%} gross" if np.mean(after > GROSS) > 5e-4 else ""
    return f"{np.quantile(before, WITHIN):.2f} -> {np.quantile(after, WITHIN):.2f}{gross}"


def _error_sigmas(scanner: Scanner, shots: list[Rendering], lights: list[Radiance]) -> np.ndarray:
    """Return depth errors in sigmas, against the truth or between two renderings.

    The difference of two renderings does not contain the error by interreflection.
    """
    depths = [scan(scanner, light, seed=seed).depth for seed, light in enumerate(lights)]
    sigma_m = np.hypot(*(depth.sigma_m for depth in depths)) if depths[1:] else depths[0].sigma_m
    other_m = depths[1].depth_m if depths[1:] else shots[0].truth.depth_m
    off = np.abs(depths[0].depth_m - other_m) / sigma_m
    return off[np.isfinite(off)]


def _scanners() -> dict[str, Scanner]:
    lens = replace(preset("like-phoxi-m"), filters=FilterSpec())
    rig = replace(lens.rig, camera=cropped(lens.rig.camera, SIZE_PX), speckle_contrast=0.0)
    sharp = preset("paper").rig
    return {
        "lenses": replace(lens, rig=rig),
        "sharp": Scanner(rig=replace(sharp, camera=cropped(sharp.camera, SIZE_PX))),
    }


def _wall(scanner: Scanner) -> Scene:
    return _scene(scanner, _quad(0.0, HALF_M, 0.3))


def _valley(scanner: Scanner) -> Scene:
    sides = (-0.5 * HALF_M, -0.6), (0.5 * HALF_M, 0.6)
    return _scene(scanner, *(_quad(x_m, 0.5 * HALF_M, slope) for x_m, slope in sides))


def _quad(x_m: float, half_m: float, slope: float) -> Quad:
    """Return a quad in the plane `z = DISTANCE_M - slope x` of the camera frame."""
    return Quad(
        center_m=(x_m, 0.0, DISTANCE_M - slope * x_m),
        half_u_m=(half_m, 0.0, -slope * half_m),
        half_v_m=(0.0, -HALF_M, 0.0),
        material=WHITE,
    )


def _scene(scanner: Scanner, *surfaces: Quad) -> Scene:
    dark = Environment(radiance=(0.0, 0.0, 0.0))
    return Scene(rig=scanner.rig, T_world_cam=np.eye(4), surfaces=surfaces, environment=dark)
