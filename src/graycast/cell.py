"""A cell: a configuration with its files read, which all scenes of a dataset share."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from .config import (
    Config,
    file_digests,
    resolve_bin,
    resolve_environment,
    resolve_lamps,
    resolve_parts,
    resolve_scanner,
)
from .pattern import Code
from .render import OnFrame, Renderer, open_renderer
from .rig import grey_levels, place, standoff_m
from .scanner import Scanner
from .scene import Scene


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

    @property
    def code(self) -> Code:
        """The code that the scanner shows."""
        return self.scanner.patterns()

    def patterns(self) -> UInt8[np.ndarray, "n ph pw"]:
        """What the projector is given: grey levels that undo its response."""
        return self.code.render(lambda share: grey_levels(self.scanner.rig, share))


def resolve_cell(config: Config, folder: Path) -> Cell:
    """Read what a configuration names; `folder` is where its relative paths start.

    Raises:
        GraycastError, ValueError: a file or a value that cannot be used, named.
    """
    parts, notes = resolve_parts(config, folder)
    scanner = resolve_scanner(config, folder)
    rig = scanner.rig
    box = resolve_bin(config.bin, folder)
    view = config.view
    target = view.target_m or (0.0, 0.0, box.inner_m[2] / 3)
    T_world_cam = place(
        rig,
        target_m=np.array(target),
        distance_m=view.distance_m or standoff_m(rig),
        tilt_rad=np.radians(view.tilt_deg),
        azimuth_rad=np.radians(view.azimuth_deg),
    )
    scene = Scene(
        rig=rig,
        T_world_cam=T_world_cam,
        parts=parts,
        bin=box,
        environment=resolve_environment(config.light.environment, folder),
        lamps=resolve_lamps(config.light),
    )
    return Cell(
        config=config,
        scene=scene,
        scanner=scanner,
        notes=notes,
        file_digests=file_digests(config, folder),
    )


def open_cell_renderer(
    cell: Cell,
    *,
    device: str = "auto",
    threads: int | None = None,
    on_frame: OnFrame | None = None,
) -> Renderer:
    """The renderer that a cell's configuration asks for; arguments as of `open_renderer`."""
    render = cell.config.render
    return open_renderer(
        render.backend,
        device=device,
        threads=threads,
        patterns_per_render=render.cycles.patterns_per_render,
        on_frame=on_frame,
    )
