"""One scene from its seeds to its measured depth: drop, light, sensor, decoding.

A scene depends only on (configuration, dataset seed, scene id).
"""

import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from ..base.progress import UNWATCHED, ProgressMeter
from ..base.public_value import public_value
from ..base.streams import image_seeds, scene_seeds
from ..base.version import __version__
from ..camera.decode import CodeMap, DepthMap, reason_shares
from ..camera.picture import color_picture, developed, gray_picture
from ..camera.scanner import Scanner, measure, take, take_exposures
from ..camera.sensor import Capture, merge_exposures
from ..dataset.files.json_text import plain
from ..dataset.files.sample import Raw, Sample
from ..dataset.write.claim import described_values
from ..rendering import GroundTruth, Radiance, Renderer, Rendering
from ..world.drop import PARTS_MAX, drop
from ..world.parts import Part, full_count
from ..world.scene import Layout, Scene, bin_of
from .config import Config, resolve_quality
from .domain import Variation, draw, moved_place, vary
from .metering import metered_region
from .moving_light import MovingLight
from .resolve import Cell, Eye, eyes, free_scanners, patterns_of
from .views import refuse_inside

_PACKAGES = ("numpy", "rapier3d", "manifold3d", "numba", "pyoidn")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Shot:
    """One finished image, with the intermediate results from its rendering to its decoded code."""

    sample: Sample
    rendering: Rendering
    capture: Capture
    codes: CodeMap

    def __repr__(self) -> str:
        """Return one line, because the arrays would fill several screens."""
        manifest, (height_px, width_px) = self.sample.manifest, self.codes.reason.shape
        of_parts = manifest["part_reasons"]
        decoded = f", {of_parts['decoded']:.0%} of the parts' pixels decoded" if of_parts else ""
        return (
            f"Shot(scene {manifest['scene_id']}, {len(self.sample.layout.part_index)} parts, "
            f"{width_px} x {height_px} px{decoded})"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Filling:
    """A filled bin: the seeds of the scene, the scene with its bin and lamps, and the layout."""

    seeds: dict[str, int]
    variation: Variation
    layout: Layout


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneImage:
    """One image of a layout: its light, its pictures and its depth."""

    rendering: Rendering
    capture: Capture
    rgb: UInt8[np.ndarray, "h w 3"]
    codes: CodeMap
    depth: DepthMap
    moving: MovingLight | None


def make_scene(
    cell: Cell,
    scene_id: int,
    *,
    seed: int,
    renderer: Renderer,
    progress: ProgressMeter = UNWATCHED,
) -> Shot:
    """Make a scene and its first image, including the data to be stored (`Sample`).

    Nothing is written to disk. `progress` is called at each step.

    Raises:
        DropError: the parts did not come to rest as required.
        ValueError: the picture is too dark, or a value is out of range.
    """
    return next(make_images(cell, scene_id, seed=seed, renderer=renderer, progress=progress))


def make_images(
    cell: Cell,
    scene_id: int,
    *,
    seed: int,
    renderer: Renderer,
    progress: ProgressMeter = UNWATCHED,
    only: int | None = None,
) -> Iterator[Shot]:
    """Yield a scene's images one by one, so that the light of only one image is in memory.

    The parts are dropped once. Every image has the ground truth of the same layout.

    Args:
        only: an index in `cell.images`; only this image is made.

    Raises:
        DropError, ValueError: as in `make_scene`.
    """
    timings: dict[str, float] = {}
    with _timed(timings, "drop"):
        filling = fill_bin(cell, scene_id, seed=seed, progress=progress)
    seeds, variation, layout = filling.seeds, filling.variation, filling.layout
    hung = images_of(cell, variation, seeds)
    for number, (eye, scene) in enumerate(hung):
        if only is not None and number != only:
            continue
        own = image_seeds(seed, scene_id, station=eye.station, image=eye.image)
        manifest = {
            "scene_id": scene_id,
            "dataset_seed": seed,
            "seeds": seeds | own,
            "counts": {
                part.name: n
                for part, n in zip(variation.scene.parts, variation.counts, strict=True)
                if n and part.labelled
            },
            "physics": {
                key: value
                for key, value in asdict(layout).items()
                if key not in ("T_world_part", "part_index")
            },
        } | ({"domain": variation.record} if variation.record else {})
        which = f" image {number + 1} of {len(hung)}" if len(hung) > 1 else ""
        progress.stage(f"{renderer.name} renders{which}")
        yield _taken(cell, eye, scene, layout, manifest, timings, renderer, progress)
        timings = {}


def fill_bin(
    cell: Cell, scene_id: int, *, seed: int, progress: ProgressMeter = UNWATCHED
) -> Filling:
    """Drop the parts of a scene into the bin.

    Raises:
        DropError, ValueError: as in `make_scene`.
    """
    seeds = cell_seeds(cell, scene_id, seed=seed)
    variation = varied(cell, scene_id, seeds)
    layout = drop(
        variation.scene,
        variation.counts,
        seed=seeds["drop"],
        limits=cell.config.drop,
        progress=progress,
    )
    return Filling(seeds=seeds, variation=variation, layout=layout)


def _taken(
    cell: Cell,
    eye: Eye,
    scene: Scene,
    layout: Layout,
    manifest: dict[str, Any],
    timings: dict[str, float],
    renderer: Renderer,
    progress: ProgressMeter,
) -> Shot:
    """Render, capture and decode one image; `manifest` and `timings` come from earlier steps."""
    config, scanner = cell.config, eye.scanner
    if cell.own:
        manifest = manifest | {"own": own_record(cell)}
    image = take_image(
        config, scanner, scene, layout, renderer,
        seeds=manifest["seeds"], timings=timings, progress=progress,
    )  # fmt: skip
    rendering, capture, codes, depth = image.rendering, image.capture, image.codes, image.depth
    manifest = manifest | {
        "backend": renderer.name,
        "device": renderer.device,
        "versions": {
            "graycast": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in _PACKAGES},
            **renderer.versions,
        },
        "exposure_s": capture.reference_s,
        **({"exposures_s": list(capture.times_s)} if scanner.exposure.auto else {}),
        **({} if image.moving is None else {"motion": image.moving.record}),
        "reasons": reason_shares(depth.reason),
        "part_reasons": reason_shares(depth.reason[on_part(scene, layout, rendering.truth)]),
        "config": config.model_dump(mode="json", exclude={"scenes", "seed"}),
        "timings": timings,
    }
    sample = Sample(
        scene=scene,
        layout=layout,
        truth=rendering.truth,
        rgb=image.rgb,
        gray=gray_picture(capture),
        scanner_depth=depth,
        modulation=codes.modulation,
        manifest=manifest,
        raw=Raw(
            scanner=scanner,
            capture=capture if config.store.frames else None,
            codes=codes if config.store.columns else None,
            flow_px=None if image.moving is None else image.moving.flow(rendering.truth),
        ),
        sensor=eye.sensor,
        image=eye.image,
    )
    return Shot(sample=sample, rendering=rendering, capture=capture, codes=codes)


def take_image(
    config: Config,
    scanner: Scanner,
    scene: Scene,
    layout: Layout,
    renderer: Renderer,
    *,
    seeds: Mapping[str, int],
    timings: dict[str, float],
    progress: ProgressMeter = UNWATCHED,
) -> SceneImage:
    """Render a layout, take its pictures, and measure its depth.

    Args:
        config: the configuration, for the quality of the rendering.
        scene: the scene with the scanner's rig and pose.
        seeds: seeds by their names in `base.streams.OF_IMAGE`.
        timings: the function adds the seconds of each stage to this dictionary.

    Raises:
        ValueError: the picture is too dark, or a value is out of range.
    """
    with _timed(timings, "render"):
        quality = resolve_quality(config)
        rendering = renderer.render(
            scene, layout, patterns_of(scanner), quality=quality, seed=seeds["render"]
        )
    moving = None
    if config.motion is not None:
        moving = MovingLight(
            renderer, scene, layout, patterns_of(scanner), config.motion,
            quality=quality, seed=seeds["render"], progress=progress,
        )  # fmt: skip
    with _timed(timings, "sensor"):
        metered = metered_region(scene, scanner.exposure)
        exposures = take_exposures(
            scanner, rendering.radiance, seed=seeds["noise"], metered=metered, light_of=moving
        )
        capture = merge_exposures(exposures)
    progress.stage("decoding the pictures")
    with _timed(timings, "picture"):
        noisy = config.render.denoise and quality.denoise == "none"
        rgb = color_picture(
            scanner,
            rendering,
            denoiser=renderer.denoiser if noisy else None,
            seed=seeds["picture"],
        )
    with _timed(timings, "decode"):
        codes, depth = measure(
            scanner,
            capture if moving is None else moving.at_rest(scanner, exposures),
            path_noise=rendering.radiance.path_noise,
        )
    return SceneImage(
        rendering=rendering,
        capture=capture,
        rgb=rgb,
        codes=codes,
        depth=depth,
        moving=moving,
    )


def own_record(cell: Cell) -> dict[str, Any]:
    """Return the replaced code or sensor of a cell's scanner for manifests; see `Cell.with_own`."""
    return {name: plain(described_values(getattr(cell.scanner, name))) for name in cell.own}


def on_part(scene: Scene, layout: Layout, truth: GroundTruth) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels that see a labelled part."""
    labelled = [scene.parts[kind].labelled for kind in layout.part_index]
    return np.array([*labelled, False])[truth.instance]  # -1 means no part


def compile_kernels(cell: Cell) -> None:
    """Compile the Numba functions of a cell's scanners, so that workers find them in the cache.

    Test pictures are converted to depth. They show the projector's image, dark on the left to
    saturated on the right, so that each reason for no depth occurs.
    """
    for _, scanner in cell.scanners:
        patterns, camera = patterns_of(scanner), scanner.rig.camera
        row = np.linspace(0, patterns.shape[1] - 1, camera.height_px).astype(int)[:, None]
        column = np.linspace(0, patterns.shape[2] - 1, camera.width_px).astype(int)
        light = np.linspace(0, 1, camera.width_px, dtype=np.float32)
        light[-1 - camera.width_px // 200 :] = 10  # few enough to be ignored by automatic exposure
        white = np.tile(light, (camera.height_px, 1))
        colour = np.repeat(white[..., None], 3, axis=2)
        radiance = Radiance(
            pattern=white * (patterns[:, row, column] / np.float32(255)),
            white=white,
            ambient=white / 10,
            white_rgb=colour,
            ambient_rgb=colour,
            albedo=colour,
            place_px=np.stack(np.broadcast_arrays(np.float32(column), np.float32(row))),
        )
        measure(scanner, take(scanner, radiance, seed=0), path_noise=None)
        developed(colour, scanner, seed=0)


def cell_seeds(cell: Cell, scene_id: int, *, seed: int) -> dict[str, int]:
    """Return the seeds of a scene of this cell, and of its first image."""
    return scene_seeds(seed, scene_id, domain=cell.domain is not None, views=cell.draws_views)


def varied(cell: Cell, scene_id: int, seeds: dict[str, int]) -> Variation:
    """Return the scene to drop and to render first: the cell's, or a variation by its domain."""
    counts = counts_of(cell, scene_id, np.random.default_rng(seeds["counts"]))
    first = eyes(cell, seeds.get("views", 0))[0]
    scene = replace(cell.scene, T_world_cam=first.T_world_cam)
    if cell.domain is None:
        return Variation(scene=scene, counts=counts, record={})
    rng = np.random.default_rng(seeds["domain"])
    record = draw(cell.domain, scene, counts, rng, scanners=free_scanners(cell))
    return vary(cell.domain, scene, counts, record)


def images_of(cell: Cell, variation: Variation, seeds: dict[str, int]) -> list[tuple[Eye, Scene]]:
    """Return the scene for each of its eyes (images), whose poses the domain's values change.

    All images of a scanner move in the same way; a mounted scanner moves with the first scanner.
    """
    first, *others = eyes(cell, seeds.get("views", 0))
    hung = [(first, variation.scene)]
    for eye in others:
        rig, T_world_cam = eye.scanner.rig, eye.T_world_cam
        if eye.T_first_cam is not None:
            T_world_cam = hung[eye.image][1].T_world_cam @ eye.T_first_cam
        elif variation.record:
            nominal = replace(cell.scene, rig=rig, T_world_cam=T_world_cam)
            T_world_cam = moved_place(nominal, variation.record, eye.sensor)
        where = f"domain.camera: image {eye.image} {eye.sensor}".rstrip()
        refuse_inside(T_world_cam, rig, bin_of(variation.scene), where)
        rig = rig if eye.station else variation.scene.rig
        hung.append((eye, replace(variation.scene, rig=rig, T_world_cam=T_world_cam)))
    return hung


def counts_of(cell: Cell, scene_id: int, rng: np.random.Generator) -> tuple[int, ...]:
    """Return the number of parts of each kind: one kind in turn, or all kinds drawn at random."""
    kinds = len(cell.scene.parts)
    if cell.config.mix:
        return mixed_counts(cell, rng)
    lying = scene_id % kinds
    total = _total(cell, cell.scene.parts[lying : lying + 1], rng)
    return tuple(total if kind == lying else 0 for kind in range(kinds))


def mixed_counts(cell: Cell, rng: np.random.Generator) -> tuple[int, ...]:
    """Return the number of parts of each kind if all kinds are drawn at random."""
    kinds = len(cell.scene.parts)
    total = _total(cell, cell.scene.parts, rng)
    return tuple(int(n) for n in rng.multinomial(total, np.full(kinds, 1 / kinds)))


def _total(cell: Cell, parts: Sequence[Part], rng: np.random.Generator) -> int:
    """Return the total number of parts, from the configured count or share of the bin."""
    if cell.config.fill is None:
        low, high = cell.config.count_range
        return int(rng.integers(low, high + 1))
    inner_m = bin_of(cell.scene).inner_m
    filled = sum(1 / full_count(part, inner_m) for part in parts) / len(parts)
    return int(np.clip(round(cell.config.fill / filled), 1, PARTS_MAX))


@contextmanager
def _timed(timings: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    timings[stage] = time.perf_counter() - start
