"""Noise and cost of light reflected by shiny parts, with and without paths from the projector.

Fifteen polished brackets are in the wooden box under white light. Each roughness is rendered with
paths from camera and projector, and with paths from the camera alone, with equal seeds and samples.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image
from scipy.ndimage import median_filter

from graycast.rendering import Quality, Renderer, open_renderer
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material
from graycast.world.scene import Layout, Scene

from .figures import Figures
from .materials import around
from .stages import cell_of

PARTS, SAMPLES, SEEDS = 15, 16, (0, 1)
ROUGHNESS = (0.05, 0.1, 0.2, 0.35, 0.5)
BASE = 0.7
FIREFLY, WINDOW_PX = 3.0, 7  # A firefly is brighter than three times the median of 7 x 7 pixels.
MATT = "matt"
CROP = np.s_[70:320, 110:410]  # the floor of the bin in a picture of small resolution


@dataclass(frozen=True, slots=True)
class Pictures:
    """White pictures of a scene by seed, and the processor time of a rendering of all patterns."""

    white: Float[np.ndarray, "seeds h w"]
    seconds: float


def rows() -> Iterator[Figures]:
    """Yield a row of results for matt parts, then for each roughness of metal."""
    cell = cell_of({"count": PARTS, "rig": "paper"})
    layout = drop(cell.scene, (PARTS,), seed=1, limits=DropLimits())
    with open_renderer("mitsuba") as renderer:
        matt = _with_material(cell.scene, Material(base_color=(BASE,) * 3, specular=0.0))
        patterns = cell.patterns()
        base = _pictures(renderer, matt, layout, patterns)
        yield {"surface": MATT, "seconds": base.seconds}
        first = renderer.render(matt, layout, patterns[:0], quality=Quality(samples=1), seed=0)
        near, bin_alone = around(first.truth.instance >= 0), first.truth.instance < 0
        for roughness in ROUGHNESS:
            metal = Material(base_color=(BASE,) * 3, metallic=1.0, roughness=roughness)
            scene = _with_material(cell.scene, metal)
            both = _pictures(renderer, scene, layout, patterns)
            with patch("graycast.rendering.mitsuba.renderer._shiny_field", lambda *of: None):
                alone = _pictures(renderer, scene, layout, patterns)
            variance = _variance(both, near) / _variance(alone, near)
            yield {
                "surface": f"roughness {roughness}",
                "seconds": both.seconds,
                "over matt": both.seconds / base.seconds,
                "over camera alone": both.seconds / alone.seconds,
                "variance": variance,
                "variance at equal time": variance * both.seconds / alone.seconds,
                "fireflies": fireflies(both.white[0], bin_alone),
                "fireflies, camera alone": fireflies(alone.white[0], bin_alone),
            }


def draw(file: Path, samples: int) -> None:
    """Draw parts of roughness 0.1 twice: with many paths from the camera, and few of both kinds."""
    cell = cell_of({"count": PARTS, "rig": "paper", "resolution": "small"})
    layout = drop(cell.scene, (PARTS,), seed=1, limits=DropLimits())
    metal = Material(base_color=(BASE,) * 3, metallic=1.0, roughness=0.1)
    scene, none = _with_material(cell.scene, metal), cell.patterns()[:0]
    with open_renderer("mitsuba") as renderer:
        with patch("graycast.rendering.mitsuba.renderer._shiny_field", lambda *of: None):
            alone = renderer.render(scene, layout, none, quality=Quality(samples=samples), seed=0)
        both = renderer.render(scene, layout, none, quality=Quality(samples=SAMPLES), seed=0)
    pair = np.hstack([one.radiance.white[CROP] for one in (alone, both)])
    grey = np.sqrt(np.clip(pair / np.quantile(pair, 0.98), 0, 1))
    Image.fromarray((255 * grey).astype(np.uint8)).save(file, quality=88)


def fireflies(white: Float[np.ndarray, "h w"], pixels: Bool[np.ndarray, "h w"]) -> float:
    """Return the light of fireflies above their neighbours' median, as a share of all light."""
    median = median_filter(white, WINDOW_PX)
    bright = pixels & (white > FIREFLY * median) & (median > 0)
    return float((white - median)[bright].sum() / white[pixels].sum())


def _with_material(scene: Scene, material: Material) -> Scene:
    return replace(scene, parts=tuple(replace(part, material=material) for part in scene.parts))


def _pictures(renderer: Renderer, scene: Scene, layout: Layout, patterns: np.ndarray) -> Pictures:
    quality = Quality(samples=SAMPLES)
    renderer.render(scene, layout, patterns, quality=quality, seed=99)  # This compiles the kernel.
    white, seconds = [], []
    for seed in SEEDS:
        start = time.process_time()
        rendering = renderer.render(scene, layout, patterns, quality=quality, seed=seed)
        seconds.append(time.process_time() - start)
        white.append(rendering.radiance.white)
    return Pictures(white=np.array(white), seconds=float(np.median(seconds)))


def _variance(pictures: Pictures, pixels: Bool[np.ndarray, "h w"]) -> float:
    return float(pictures.white.var(axis=0, ddof=1)[pixels].mean())
