"""Keep the results of all stages, and make a requested picture from results that are still valid.

Each product is stored with a key that depends on its inputs. If only settings of later stages than
the light have changed (exposure, sensor, decoder, filters, faults), the stored radiance is measured
again. Radiance is linear in the projector's power and in the ambient light, so these are factors.
If the light has changed, it is rendered roughly first, and then as configured. Parts are dropped
again only if the physics has changed.

A finished picture equals that of `make_scene` bit for bit, because stages and seeds are the same. A
scaled radiance differs in its last bits, so it is shown at once and rendered again afterwards.
"""

import hashlib
import json
import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ...base.errors import ConfigError
from ...base.progress import Stages
from ...camera.picture import color_light, developed
from ...camera.scanner import measure, take
from ...camera.sensor import Capture
from ...cell.config import Config, resolve_quality, resolve_scanner, resolve_scanners
from ...cell.metering import metered_region
from ...cell.resolve import Cell, file_digests, open_cell_renderer, resolve_cell
from ...cell.simulate import cell_seeds, varied
from ...dataset.write.claim import described_values
from ...rendering import Quality, Renderer, Rendering
from ...world.drop import DropLimits, drop
from ...world.scene import Layout, Scene
from .asking import Answer, Ask
from .showing import PageContent, picture_answer, world_answer, world_key

FREE_SECTIONS = ("exposure", "sensor", "decode", "filters", "faults", "store", "scenes")
ROUGH = (1, 4)  # samples per pixel of the rough pictures

Emit = Callable[[Answer], None]


class Superseded(Exception):
    """Signals that a newer request has arrived, so the result of the current work is not needed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LightState:
    """A rendering, and the light for which it was made."""

    key: Hashable  # The key identifies the light without its two factors.
    number: int  # Each rendering has its own number.
    ambient: float
    power: float
    quality: Quality
    final: bool  # whether the rendering has all configured samples
    rendering: Rendering


class Line:
    """The latest product of every stage. Only one thread may use it, because of Mitsuba."""

    def __init__(
        self,
        *,
        folder: Path,
        scene_id: int,
        device: str,
        emit: Emit,
        superseded: Callable[[], bool],
    ) -> None:
        """Start without products.

        Args:
            folder: the folder that relative paths in the configuration refer to.
            emit: function that receives every answer.
            superseded: function that returns whether a newer request has arrived.
        """
        self._folder, self._scene_id, self._device = folder, scene_id, device
        self._emit, self._superseded = emit, superseded
        self._cell: tuple[Hashable, Cell] | None = None
        self._digests: tuple[str, list[Hashable], Mapping[str, str]] | None = None
        self._renderer: tuple[Hashable, Renderer] | None = None
        self._lain: tuple[Hashable, Layout] | None = None
        self._lit: LightState | None = None
        self._taken: tuple[Hashable, Capture] | None = None
        self._linear: tuple[Hashable, Float[np.ndarray, "h w 3"]] | None = None
        self._rgb: tuple[Hashable, UInt8[np.ndarray, "h w 3"]] | None = None
        self._world = ""
        self._count = 0
        self.content: PageContent | None = None

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer[1].close()

    def show(self, ask: Ask) -> None:
        """Make and emit the requested picture; emit rough pictures first if the light is rendered.

        Raises:
            Superseded: a newer request arrived first.
            GraycastError, ValueError, OSError: see `resolve_cell` and `make_scene`.
        """
        start = time.perf_counter()
        cell = self._resolved(ask.config)
        seeds = cell_seeds(cell, self._scene_id, seed=ask.config.seed)
        variation = varied(cell, self._scene_id, seeds)
        scene = variation.scene
        physics = _physics_key(scene, variation.counts, seeds["drop"], ask.config.drop)
        layout, fell = self._layout(physics, scene, variation.counts, seeds["drop"], ask)
        run = _Run(ask=ask, cell=cell, scene=scene, layout=layout, seeds=seeds, start=start)
        key = (_light_key(ask.unturned, self._folder, self._files(ask.config)), physics)
        lit = self._lit if self._lit is not None and self._lit.key == key else None
        if lit is not None:
            exact = lit.final and (lit.ambient, lit.power) == (ask.ambient, ask.power)
            self._finish(run, lit, kind="free", exact=exact, first=True)
            if exact:
                return
        first = lit is None
        for quality in _qualities(resolve_quality(ask.config), lit):
            if self._superseded():
                raise Superseded
            final = quality == resolve_quality(ask.config)
            rendering = self._render(run, quality)
            self._count += 1
            self._lit = LightState(
                key=key,
                number=self._count,
                ambient=ask.ambient,
                power=ask.power,
                quality=quality,
                final=final,
                rendering=rendering,
            )
            kind = "physics" if fell else "light" if lit is None else "free"
            self._finish(run, self._lit, kind=kind, exact=final, first=first)
            first = False

    def look(self, ask: Ask) -> None:
        """Show another captured frame; if a file has changed, make the whole picture again."""
        key = _light_key(ask.config, self._folder, self._files(ask.config))
        if self._cell is None or self._cell[0] != key:
            self.show(ask)
        elif self.content is not None:
            self._emit(picture_answer(ask, self.content, kind="look", ms=0.0, first=False))

    # --- the stages ---------------------------------------------------------------------------

    def _resolved(self, config: Config) -> Cell:
        """Return the cell; resolve it again if its light or its files have changed.

        Files are compared by content, because a file can change without a change of its name.
        """
        if config.motion is not None:
            raise ConfigError(
                "the page shows a cell in which nothing moves: remove motion, or make scenes of it "
                "with graycast generate"
            )
        key = _light_key(config, self._folder, self._files(config))
        if self._cell is not None and self._cell[0] == key:
            scanner = resolve_scanner(config, self._folder)
            cell = replace(self._cell[1], config=config, scanner=scanner)
        else:
            cell = resolve_cell(config, self._folder, progress=Stages(self._stage))
        self._cell = key, cell
        return cell

    def _files(self, config: Config) -> Mapping[str, str]:
        """Return the digests of the configuration's files; read only the files that changed.

        If a file is unreadable, the result is empty; resolving the cell then reports the error.
        """
        words = _words(config)
        if self._digests is not None and self._digests[0] == words:
            _, states, digests = self._digests
            if states == [_state(self._folder / name) for name in digests]:
                return digests
        try:
            digests = file_digests(config, self._folder)
        except OSError:
            return {}
        self._digests = words, [_state(self._folder / name) for name in digests], digests
        return digests

    def _stage(self, stage: str) -> None:
        if self._superseded():
            raise Superseded
        self._emit(Answer(kind="stage", number=-1, header={"stage": stage}, arrays={}))

    def _layout(
        self, key: Hashable, scene: Scene, counts: tuple[int, ...], seed: int, ask: Ask
    ) -> tuple[Layout, bool]:
        """Return the layout of the parts, and whether the parts were dropped for it."""
        if self._lain is not None and self._lain[0] == key:
            return self._lain[1], False
        limits = ask.config.drop
        layout = drop(scene, counts, seed=seed, limits=limits, progress=Stages(self._stage))
        self._lain = key, layout
        return layout, True

    def _render(self, run: "_Run", quality: Quality) -> Rendering:
        config = run.ask.config
        self._stage(f"{config.render.backend} renders {quality.samples} samples")
        renderer = self._opened(run.cell)
        return renderer.render(
            run.scene, run.layout, run.cell.patterns(), quality=quality, seed=run.seeds["render"]
        )

    def _opened(self, cell: Cell) -> Renderer:
        render = cell.config.render
        key = (render.backend, render.cycles.patterns_per_render)
        if self._renderer is None or self._renderer[0] != key:
            if self._renderer is not None:
                self._renderer[1].close()
            renderer = open_cell_renderer(cell, device=self._device, on_pass=self._passed)
            self._renderer = key, renderer
        return self._renderer[1]

    def _passed(self, done: int, total: int) -> None:
        """Stop a long rendering if a newer request has arrived; rough renderings are finished."""
        if total > max(ROUGH) and done < total and self._superseded():
            raise Superseded

    def _finish(self, run: "_Run", lit: LightState, *, kind: str, exact: bool, first: bool) -> None:
        """Measure and show a rendering; if the colour picture takes longer, it follows."""
        scanner, ask = run.cell.scanner, run.ask
        power, ambient = ask.power / lit.power, ask.ambient / (lit.ambient or 1.0)
        light, rendering = (lit.number, power, ambient), _scaled(lit.rendering, power, ambient)
        key = (light, scanner.sensor, scanner.exposure, run.seeds["noise"])
        if self._taken is None or self._taken[0] != key:
            capture = take(
                scanner,
                rendering.radiance,
                seed=run.seeds["noise"],
                metered=metered_region(run.scene, scanner.exposure),
            )
            self._taken = key, capture
        noise = rendering.radiance.path_noise
        codes, depth = measure(scanner, self._taken[1], path_noise=noise)
        look = (light, exact, scanner.sensor, run.seeds["picture"])
        rgb = self._rgb[1] if self._rgb is not None and self._rgb[0] == look else None
        self.content = PageContent(
            cell=run.cell,
            scene=run.scene,
            layout=run.layout,
            rendering=rendering,
            samples=lit.quality.samples,
            exact=exact and rgb is not None,
            capture=self._taken[1],
            codes=codes,
            depth=depth,
            rgb=rgb,
        )
        self._emit(picture_answer(ask, self.content, kind=kind, ms=run.ms, first=first))
        self._tell_world(ask)
        if rgb is not None:
            return
        if self._superseded():
            raise Superseded
        linear = self._color_light(run, rendering, (light, exact))
        rgb = developed(linear, scanner, seed=run.seeds["picture"])
        self._rgb = look, rgb
        self.content = replace(self.content, rgb=rgb, exact=exact)
        self._emit(picture_answer(ask, self.content, kind=kind, ms=run.ms, first=False))

    def _tell_world(self, ask: Ask) -> None:
        """Emit the bodies of the 3D view if they have changed."""
        assert self.content is not None
        key = world_key(self.content)
        if key != self._world:
            self._world = key
            self._emit(world_answer(ask, self.content))

    def _color_light(
        self, run: "_Run", rendering: Rendering, key: tuple[Hashable, bool]
    ) -> Float[np.ndarray, "h w 3"]:
        """Return the light of the colour picture, which is denoised once the rendering is final."""
        quality = resolve_quality(run.ask.config)
        noisy = run.ask.config.render.denoise and quality.denoise == "none"
        denoiser = self._opened(run.cell).denoiser if noisy and key[1] else None
        if self._linear is None or self._linear[0] != (key, denoiser):
            light = color_light(run.cell.scanner.rig, rendering, denoiser=denoiser)
            self._linear = (key, denoiser), light
        return self._linear[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """The common inputs of all pictures of one request."""

    ask: Ask
    cell: Cell
    scene: Scene
    layout: Layout
    seeds: Mapping[str, int]
    start: float

    @property
    def ms(self) -> float:
        return 1e3 * (time.perf_counter() - self.start)


def _light_key(config: Config, folder: Path, digests: Mapping[str, str]) -> Hashable:
    """Return a cache key of everything in the configuration and its files that affects the light.

    Args:
        digests: digests of the configuration's files, except rigs, which are read here.
    """
    rigs = [
        (name, described_values(scanner.rig), described_values(scanner.code))
        for name, scanner in resolve_scanners(config, folder)
    ]
    return (
        _words(config),
        json.dumps(rigs, default=np.ndarray.tolist),
        tuple(sorted(digests.items())),
    )


def _words(config: Config) -> str:
    """Return the part of the configuration that determines the world and its light, as text."""
    return config.model_dump_json(exclude=set(FREE_SECTIONS))


def _state(file: Path) -> Hashable:
    """Return a value that changes when a file is written; None if the file does not exist."""
    try:
        state = file.stat()
    except OSError:
        return None
    return state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns


def _qualities(wanted: Quality, lit: LightState | None) -> list[Quality]:
    """Return rough qualities that are better than the present picture, then the wanted one."""
    there = lit.quality.samples if lit is not None else 0
    rough = [replace(wanted, samples=n) for n in ROUGH if there < n < wanted.samples]
    return [*rough, wanted]


def _scaled(rendering: Rendering, power: float, ambient: float) -> Rendering:
    """Return the rendering with other factors for projector power and ambient light.

    A light whose factor was 0 cannot be scaled up; it is missing until it is rendered again.
    """
    if power == ambient == 1:
        return rendering
    light = rendering.radiance
    radiance = replace(
        light,
        pattern=_times(light.pattern, power),
        white=_times(light.white, power),
        ambient=_times(light.ambient, ambient),
        white_rgb=_times(light.white_rgb, power),
        ambient_rgb=_times(light.ambient_rgb, ambient),
    )
    return replace(rendering, radiance=radiance)


def _times(light: Float[np.ndarray, "..."], factor: float) -> Float[np.ndarray, "..."]:
    """Scale a light; a factor of 1 makes no copy, since copying a stack takes 15 ms."""
    return light if factor == 1 else light * np.float32(factor)


def _physics_key(scene: Scene, counts: tuple[int, ...], seed: int, limits: DropLimits) -> Hashable:
    """Return a cache key of all values that `drop` uses: shapes, masses, friction and limits."""
    box = scene.bin
    assert box is not None  # A cell always has a bin.

    def solid(mesh: Any) -> str:
        digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices_m).tobytes())
        digest.update(np.ascontiguousarray(mesh.faces).tobytes())
        return digest.hexdigest()

    room = solid(box.mesh) if box.mesh is not None else (box.inner_m, box.wall_m)
    parts = tuple((solid(p.mesh), p.density_kg_m3, p.friction) for p in scene.parts)
    return room, box.friction, parts, counts, seed, limits
