"""A cell: a configuration with its files read, which all scenes of a dataset share."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from .config import (
    Config,
    ViewSection,
    file_digests,
    resolve_bin,
    resolve_environment,
    resolve_parts,
    resolve_scanner,
)
from .domain import Domain, deepest_m, resolve_domain
from .drop import OnStage
from .parts import Part
from .parts.sections import resolve_material
from .pattern import Code
from .render import OnFrame, OnPass, Renderer, open_renderer
from .rig import Rig, grey_levels, place, standoff_m
from .scanner import Scanner
from .scene import Bin, Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A configuration with its files read: what all scenes of a dataset share.

    `scene` holds every kind of part; a scene drops one kind of it, or all where `config.mix`.
    """

    config: Config
    scene: Scene
    scanner: Scanner
    notes: tuple[str, ...]
    file_digests: dict[str, str]
    domain: Domain | None = None

    @property
    def kinds(self) -> tuple[Part, ...]:
        """Every kind of part that may lie in a scene, distractors last."""
        return self.scene.parts + (self.domain.distractors if self.domain else ())

    @property
    def code(self) -> Code:
        """The code that the scanner shows."""
        return self.scanner.light_code()

    def patterns(self) -> UInt8[np.ndarray, "n ph pw"]:
        """What the projector is given: grey levels that undo its response."""
        return self.code.render(lambda share: grey_levels(self.scanner.rig, share))


def resolve_cell(config: Config, folder: Path, *, on_stage: OnStage = lambda stage: None) -> Cell:
    """Read what a configuration names; `folder` is where its relative paths start.

    `on_stage` is told what is read, where that may take seconds.

    Raises:
        GraycastError, ValueError: a file or a value that cannot be used, named.
    """
    parts, notes = resolve_parts(config, folder, on_stage=on_stage)
    scanner = resolve_scanner(config, folder)
    rig = scanner.rig
    if config.bin.mesh is not None:
        on_stage(f"reading {config.bin.mesh}")
    box, bin_notes = resolve_bin(config.bin, folder)
    scene = Scene(
        rig=rig,
        T_world_cam=hang(config.view, rig, box),
        parts=parts,
        bin=box,
        environment=resolve_environment(config.light.environment, folder),
        lamps=config.light.lamps,
    )
    if config.table is not None:
        scene = replace(scene, table=resolve_material(config.table, folder))
    if config.domain is not None:
        on_stage("reading the files that the domain names")
    domain = None if config.domain is None else resolve_domain(config.domain, folder, scene=scene)
    return Cell(
        config=config,
        scene=scene,
        scanner=scanner,
        notes=notes + bin_notes + (domain.notes if domain else ()),
        file_digests=file_digests(config, folder),
        domain=domain,
    )


def reach_m(cell: Cell) -> float:
    """How deep a cell's depth pictures must reach [m], as z of the camera.

    To the end of the rig's working range, and to the deepest corner of the bin wherever the domain
    may hang the rig. What lies deeper is the table, which has no end.
    """
    return max(cell.scene.rig.far_m, deepest_m(cell.config.domain, cell.scene))


def hang(view: ViewSection, rig: Rig, box: Bin) -> Float[np.ndarray, "4 4"]:
    """`T_world_cam`: the one given, or the rig placed above the bin."""
    if view.T_world_cam is not None:
        return np.reshape(view.T_world_cam, (4, 4)).astype(np.float64)
    return place(
        rig,
        target_m=np.array(view.target_m or (0.0, 0.0, box.inner_m[2] / 3)),
        distance_m=view.distance_m or standoff_m(rig),
        tilt_rad=np.radians(view.tilt_deg),
        azimuth_rad=np.radians(view.azimuth_deg),
    )


def open_cell_renderer(
    cell: Cell,
    *,
    device: str = "auto",
    threads: int | None = None,
    on_frame: OnFrame | None = None,
    on_pass: OnPass | None = None,
) -> Renderer:
    """The renderer that a cell's configuration asks for; arguments as of `open_renderer`."""
    render = cell.config.render
    return open_renderer(
        render.backend,
        device=device,
        threads=threads,
        patterns_per_render=render.cycles.patterns_per_render,
        on_frame=on_frame,
        on_pass=on_pass,
    )
