"""One scene all the way from its seeds to what is measured: drop, light, sensor, decoding.

A scene depends on (configuration, dataset seed, scene id) alone.
"""

import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version

import numpy as np

from . import __version__
from .cell import Cell
from .config import resolve_quality
from .dataset import Raw, Sample
from .dataset.seeds import scene_seeds
from .decode import CodeMap, reason_shares
from .domain import Variation, draw, vary
from .drop import OnStage as OnStage
from .drop import drop
from .picture import color_picture, gray_picture
from .render import Renderer, Rendering
from .scanner import measure, take
from .scene import Layout, Scene
from .sensor import Capture


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One finished scene with what lies between radiance and sample, for pictures of it."""

    sample: Sample
    rendering: Rendering
    capture: Capture
    codes: CodeMap


def make_scene(
    cell: Cell,
    scene_id: int,
    *,
    seed: int,
    renderer: Renderer,
    on_stage: OnStage = lambda stage: None,
) -> Shot:
    """One scene from its seeds to its sample; `on_stage` is told what begins.

    Raises:
        DropError: the parts did not come to an acceptable rest.
        ValueError: the picture is dark, or a value is out of its range.
    """
    config = cell.config
    seeds = scene_seeds(seed, scene_id, domain=config.domain is not None)
    timings: dict[str, float] = {}
    with _timed(timings, "drop"):
        variation, layout = _laid(cell, scene_id, seeds, on_stage)
        scene, counts = variation.scene, variation.counts
    on_stage(f"{renderer.name} renders")
    with _timed(timings, "render"):
        quality = resolve_quality(config)
        rendering = renderer.render(
            scene, layout, cell.patterns(), quality=quality, seed=seeds["render"]
        )
    with _timed(timings, "sensor"):
        capture = take(cell.scanner, rendering.radiance, seed=seeds["noise"])
    on_stage("decoding the pictures")
    with _timed(timings, "picture"):
        noisy = config.render.denoise and quality.denoise == "none"
        rgb = color_picture(
            cell.scanner,
            rendering,
            denoiser=renderer.denoiser if noisy else None,
            seed=seeds["picture"],
        )
    with _timed(timings, "decode"):
        codes, depth = measure(cell.scanner, capture)
    manifest = {
        "scene_id": scene_id,
        "dataset_seed": seed,
        "seeds": seeds,
        "backend": renderer.name,
        "device": renderer.device,
        "versions": _versions(renderer),
        "counts": {
            part.name: n for part, n in zip(scene.parts, counts, strict=True) if n and part.labelled
        },
        "physics": {
            key: value
            for key, value in asdict(layout).items()
            if key not in ("T_world_part", "part_index")
        },
        "exposure_s": float(np.max(capture.exposure_s)),
        "reasons": reason_shares(depth.reason),
        "config": config.model_dump(mode="json", exclude={"scenes", "seed"}),
        "timings": timings,
    } | ({"domain": variation.record} if variation.record else {})
    sample = Sample(
        scene=scene,
        layout=layout,
        truth=rendering.truth,
        rgb=rgb,
        gray=gray_picture(capture),
        scanner=depth,
        modulation=codes.modulation,
        manifest=manifest,
        raw=Raw(
            scanner=cell.scanner,
            capture=capture if config.store.frames else None,
            codes=codes if config.store.columns else None,
        ),
    )
    return Shot(sample=sample, rendering=rendering, capture=capture, codes=codes)


def lay_out(
    cell: Cell, scene_id: int, *, seed: int, on_stage: OnStage = lambda stage: None
) -> tuple[Scene, Layout]:
    """The scene that `make_scene` would render, and where its parts came to lie.

    Raises:
        DropError: the parts did not come to an acceptable rest.
    """
    seeds = scene_seeds(seed, scene_id, domain=cell.config.domain is not None)
    variation, layout = _laid(cell, scene_id, seeds, on_stage)
    return variation.scene, layout


def _laid(
    cell: Cell, scene_id: int, seeds: dict[str, int], on_stage: OnStage
) -> tuple[Variation, Layout]:
    variation = varied(cell, scene_id, seeds)
    layout = drop(
        variation.scene,
        variation.counts,
        seed=seeds["drop"],
        limits=cell.config.drop,
        on_stage=on_stage,
    )
    return variation, layout


def varied(cell: Cell, scene_id: int, seeds: dict[str, int]) -> Variation:
    """What a scene drops and renders: as the cell's domain has it, without one the cell's own."""
    counts = counts_of(cell, scene_id, np.random.default_rng(seeds["counts"]))
    if cell.domain is None:
        return Variation(scene=cell.scene, counts=counts, record={})
    rng = np.random.default_rng(seeds["domain"])
    record = draw(cell.domain, cell.scene, counts, rng)
    return vary(cell.domain, cell.scene, counts, record)


def counts_of(cell: Cell, scene_id: int, rng: np.random.Generator) -> tuple[int, ...]:
    """How many of each kind: one kind in turn, or all kinds drawn at random."""
    low, high = cell.config.count_range
    total = int(rng.integers(low, high + 1))
    kinds = len(cell.scene.parts)
    if cell.config.mix:
        return tuple(int(n) for n in rng.multinomial(total, np.full(kinds, 1 / kinds)))
    return tuple(total if kind == scene_id % kinds else 0 for kind in range(kinds))


@contextmanager
def _timed(timings: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    timings[stage] = time.perf_counter() - start


def _versions(renderer: Renderer) -> dict[str, str]:
    packages = ("numpy", "rapier3d", "manifold3d", "numba", "pyoidn")
    return {
        "graycast": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        **renderer.versions,
    }
