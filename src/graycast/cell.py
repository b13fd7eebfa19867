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
    """A configuration with all its files read. All scenes of a dataset share it.

    `scene` holds every kind of part; a scene drops one of the kinds, or all if `config.mix` is set.
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
        """The grey levels for the projector, with its response inverted."""
        return self.code.render(lambda share: grey_levels(self.scanner.rig, share))


def resolve_cell(config: Config, folder: Path, *, on_stage: OnStage = lambda stage: None) -> Cell:
    """Read the files that a configuration names; relative paths start in `folder`.

    `on_stage` is called with the name of each step that may take seconds.

    Raises:
        GraycastError, ValueError: a file or a value cannot be used; the error names it.
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
        on_stage("reading the files of the domain section")
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
    """The largest depth that a cell's depth pictures must hold [m], along the camera's z.

    It covers the rig's working range and the deepest corner of the bin for every pose of the
    rig that the domain allows. Only the table, which is infinite, lies deeper.
    """
    return max(cell.scene.rig.far_m, deepest_m(cell.config.domain, cell.scene))


def hang(view: ViewSection, rig: Rig, box: Bin) -> Float[np.ndarray, "4 4"]:
    """`T_world_cam` as configured, or from the rig's place above the bin."""
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
    """Open the renderer that a cell's configuration names; see `open_renderer`."""
    render = cell.config.render
    return open_renderer(
        render.backend,
        device=device,
        threads=threads,
        patterns_per_render=render.cycles.patterns_per_render,
        on_frame=on_frame,
        on_pass=on_pass,
    )
