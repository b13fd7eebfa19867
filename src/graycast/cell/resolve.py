"""A cell: a configuration with its files' contents, which all scenes of a dataset share."""

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ..base import array_types as arrays
from ..base.errors import ConfigError
from ..base.progress import UNWATCHED, ProgressMeter
from ..base.public_value import public_value
from ..base.streams import station_stream
from ..camera.decode import triangulation_axis
from ..camera.scanner import Scanner
from ..camera.sensor import SensorSpec
from ..rendering import OnPass, Renderer, open_renderer
from ..rig.pair import grey_levels
from ..rig.pattern import Code
from ..world.parts import Part, files_of_mesh, glass_notes, size_notes
from ..world.parts.material_section import resolve_material
from ..world.scene import Scene, bin_of
from .config import (
    Config,
    RenderSection,
    load_config,
    resolve_bin,
    resolve_environment,
    resolve_parts,
    resolve_scanners,
)
from .domain import Domain, deepest_m, domain_files, resolve_domain
from .views import (
    DomeSection,
    JitterSection,
    Pose,
    Sampler,
    ViewSection,
    farthest,
    hang,
    how_many,
    places,
    refuse_inside,
    refuse_outside,
)

_Poses = Callable[..., tuple[Pose, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Eye:
    """One image of a scene: the scanner and its pose.

    `sensor` is the scanner's name, or "" if it is the only one; `image` is the number of its image,
    from 0; `station` is its index in the configuration. `T_first_cam` is the pose of a scanner that
    is mounted on the first one and moves with its image of the same number; otherwise it is None.
    """

    sensor: str
    image: int
    station: int
    scanner: Scanner
    T_world_cam: Pose
    T_first_cam: Pose | None = None


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A configuration with its files' contents. All scenes of a dataset share it.

    `scene` has every kind of part; a scene drops one of the kinds, or all if `config.mix` is set.
    Its rig and pose, and `scanner`, belong to the first image. `named` has all scanners by name, if
    the configuration names them.
    """

    config: Config
    scene: Scene
    scanner: Scanner
    notes: tuple[str, ...]
    file_digests: dict[str, str]
    domain: Domain | None = None
    own: tuple[str, ...] = ()  # values that the configuration does not have; see `with_own`
    named: tuple[tuple[str, Scanner], ...] = ()

    @property
    def kinds(self) -> tuple[Part, ...]:
        """All kinds of parts that may be in a scene, distractors last."""
        return self.scene.parts + (self.domain.distractors if self.domain else ())

    @property
    def code(self) -> Code:
        """The code that the scanner projects."""
        return self.scanner.light_code()

    def with_own(self, *, code: Code | None = None, sensor: SensorSpec | None = None) -> "Cell":
        """Return the cell with a code or a sensor that its configuration does not name.

        All functions accept such a cell. Its datasets store the code and the sensor in
        `graycast.json`, and under `own` in the manifest of each scene.

        Args:
            code: frames for the projector of the rig; None keeps the present code.
            sensor: the sensor's noise and converter; None keeps the present sensor.

        Raises:
            ConfigError: the cell has several scanners, or the code lacks the axis that is
                parallel to the baseline.
            ValueError: the code is for a projector of a different size.
        """
        if self.named:
            raise ConfigError("the cell has several scanners: give one of a single scanner")
        changes: dict[str, Any] = {
            k: v for k, v in (("code", code), ("sensor", sensor)) if v is not None
        }
        scanner: Scanner = replace(self.scanner, **changes)
        scanner.light_code()
        axis = triangulation_axis(scanner.rig)
        if axis not in scanner.code.axes:
            raise ConfigError(f"code has no {axis} frames: rig {scanner.rig.name} needs them")
        own = tuple(sorted({*self.own, *changes}))
        return replace(self, scanner=scanner, own=own)

    def patterns(self) -> arrays.UInt8Array_n_ph_pw:
        """Return grey levels for the projector, with its response inverted."""
        return patterns_of(self.scanner)

    @property
    def scanners(self) -> tuple[tuple[str, Scanner], ...]:
        """Every scanner with its name, which is "" for a single scanner."""
        return self.named or (("", self.scanner),)

    @property
    def draws_views(self) -> bool:
        """Whether each scene has its own random places for its images."""
        own = [_own_views(self.config, station) for station in range(len(self.scanners))]
        return any(isinstance(views, DomeSection | JitterSection) for views in own)

    @property
    def images(self) -> tuple[tuple[str, int], ...]:
        """Every image of a scene: its scanner's name, and its number for that scanner."""
        numbers: list[int] = []
        for station in range(len(self.scanners)):
            views = _own_views(self.config, station)
            mounted = _mounting(self, station) is not None
            numbers.append(numbers[0] if mounted else how_many(views))
        return tuple(
            (name, image)
            for (name, _), number in zip(self.scanners, numbers, strict=True)
            for image in range(number)
        )


def require_one_still_image(cell: Cell, who: str) -> None:
    """Refuse a cell with several images per scene, or with motion, in a stage without either.

    Raises:
        ConfigError: the configuration asks for several images or for motion.
    """
    if cell.config.views is not None or cell.config.scanners is not None:
        raise ConfigError(
            f"{who} takes one image of a scene: remove views and scanners, and say view and rig"
        )
    if cell.config.motion is not None:
        raise ConfigError(f"{who} needs a cell in which nothing moves: remove motion")


def patterns_of(scanner: Scanner) -> UInt8[np.ndarray, "n ph pw"]:
    """Return the grey levels for a scanner's projector, with its response inverted."""
    return scanner.light_code().render(lambda share: grey_levels(scanner.rig, share))


def eyes(cell: Cell, seed: int) -> tuple[Eye, ...]:
    """Return every image of one scene, scanner by scanner, at the configured poses.

    Args:
        seed: the seed of the scene's views, from which each scanner has its own stream; listed
            places do not depend on it.

    Raises:
        ConfigError: a camera or projector would be inside the bin.
    """
    images: list[Eye] = []
    box = bin_of(cell.scene)

    def of_station(station: int) -> _Poses:
        return partial(places, rng=station_stream(seed, station))

    for station, poses in _stations(cell, of_station):
        (name, scanner), T_first_cam = cell.scanners[station], _mounting(cell, station)
        for image, T_world_cam in enumerate(poses):
            if T_first_cam is not None:
                refuse_inside(T_world_cam, scanner.rig, box, f"scanner {name}: image {image}")
            where = " ".join(filter(None, (name, f"image {image}")))
            refuse_outside(T_world_cam, scanner.rig, box, where)
            images.append(
                Eye(
                    sensor=name,
                    image=image,
                    station=station,
                    scanner=scanner,
                    T_world_cam=T_world_cam,
                    T_first_cam=T_first_cam,
                )
            )
    return tuple(images)


def _stations(
    cell: Cell, poses_of: Callable[[int], _Poses]
) -> Iterator[tuple[int, tuple[Pose, ...]]]:
    """Yield the index of each scanner in the configuration, and its poses.

    Args:
        poses_of: returns, for a scanner's index, the function that makes poses of its views, the
            configuration's single view, rig and bin.
    """
    config, box = cell.config, bin_of(cell.scene)
    first: tuple[Pose, ...] = ()
    for station, (_, scanner) in enumerate(cell.scanners):
        views, T_first_cam = _own_views(config, station), _mounting(cell, station)
        if T_first_cam is not None:
            poses = tuple(T_world_first @ T_first_cam for T_world_first in first)
        elif views is not None:
            poses = poses_of(station)(views, config.view, scanner.rig, box)
        else:
            poses = (hang(config.view, scanner.rig, box) if station else cell.scene.T_world_cam,)
        first = first or poses
        yield station, poses


def free_scanners(cell: Cell) -> tuple[str, ...]:
    """Return the names of the scanners after the first that are not mounted on it."""
    names = [name for name, _ in cell.scanners]
    return tuple(name for i, name in enumerate(names) if i and _mounting(cell, i) is None)


def _mounting(cell: Cell, station: int) -> Pose | None:
    numbers = None if cell.config.scanners is None else cell.config.scanners[station].T_first_cam
    return None if numbers is None else np.reshape(numbers, (4, 4)).astype(np.float64)


def _own_views(config: Config, station: int) -> tuple[ViewSection, ...] | Sampler | None:
    own = None if config.scanners is None else config.scanners[station].views
    return config.views if own is None else own


def resolve_cell(config: Config, folder: Path, *, progress: ProgressMeter = UNWATCHED) -> Cell:
    """Return a cell from a configuration and its files; relative paths start in `folder`.

    `progress` is called at each step that may take seconds.

    Raises:
        GraycastError, ValueError: a file or a value cannot be used; the error names it.
    """
    parts, notes = resolve_parts(config, folder, progress=progress)
    scanners = resolve_scanners(config, folder)
    scanner = scanners[0][1]
    rig = scanner.rig
    if config.bin.mesh is not None:
        progress.stage(f"reading {config.bin.mesh}")
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
        progress.stage("reading the files of the domain section")
    domain = None if config.domain is None else resolve_domain(config.domain, folder, scene=scene)
    cell = Cell(
        config=config,
        scene=scene,
        scanner=scanner,
        notes=(
            *notes,
            *size_notes(parts, box.inner_m),
            *glass_notes(scene.parts + (domain.distractors if domain else ())),
            *bin_notes,
            *(domain.notes if domain else ()),
        ),
        file_digests=file_digests(config, folder),
        domain=domain,
        named=() if config.scanners is None else scanners,
    )
    return replace(cell, scene=replace(scene, T_world_cam=eyes(cell, 0)[0].T_world_cam))


def load_cell(
    source: Config | Path | str,
    *,
    folder: Path | str | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> Cell:
    """Read a cell: a configuration with all files that it names.

    Args:
        source: a configuration, or its YAML file.
        folder: where relative paths of the configuration start; None is the folder of the file, or
            the current folder for a configuration made in Python.
        progress: called at each step that may take seconds.

    Raises:
        GraycastError, ValueError: a file or a value cannot be used; the error names it.
    """
    if isinstance(source, Config):
        return resolve_cell(source, Path(folder or "."), progress=progress)
    path = Path(source)
    return resolve_cell(load_config(path), Path(folder or path.parent), progress=progress)


def reach_m(cell: Cell) -> float:
    """Return the largest depth that a cell's depth pictures must hold [m], along the camera's z.

    It covers the rig's working range and the deepest corner of the bin for every pose of the rig
    that the domain allows. Only the table, which is infinite, is deeper.
    """
    depths_m = []
    for station, poses in _stations(cell, lambda _: farthest):
        rig = cell.scanners[station][1].rig
        scenes = (replace(cell.scene, rig=rig, T_world_cam=T) for T in poses)
        depths_m += [rig.far_m, *(deepest_m(cell.config.domain, scene) for scene in scenes)]
    return max(depths_m)


def open_cell_renderer(
    cell: Cell,
    *,
    device: str = "auto",
    threads: int | None = None,
    progress: ProgressMeter = UNWATCHED,
    on_pass: OnPass | None = None,
) -> Renderer:
    """Open the renderer that a cell's configuration names; see `open_renderer`.

    `progress` counts the renders of a scene. `on_pass` may end a rendering early.
    """
    return open_configured(
        cell.config.render, device=device, threads=threads, progress=progress, on_pass=on_pass
    )


def open_configured(
    render: RenderSection,
    *,
    device: str = "auto",
    threads: int | None = None,
    progress: ProgressMeter = UNWATCHED,
    on_pass: OnPass | None = None,
) -> Renderer:
    """Open the renderer of a section `render`, as `open_cell_renderer` does."""
    return open_renderer(
        render.backend,
        device=device,
        threads=threads,
        patterns_per_render=render.cycles.patterns_per_render,
        on_frame=lambda done, total: progress.count("renders of a scene", done, total),
        on_pass=on_pass,
    )


def file_digests(config: Config, folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file that a configuration names, so that a change is noticed.

    The files include the materials and pictures that a mesh file uses. File names are as in the
    configuration, or begin with the folder of the mesh there.
    """
    named = [section.mesh for section in config.parts]
    named.append(config.bin.mesh)
    surfaces = [section.material for section in config.parts]
    surfaces += [config.bin.material, config.bin.floor, config.table]
    named += [path for look in surfaces if look is not None for path in look.files.values()]
    named.append(config.light.environment.map)
    named += domain_files(config.domain, folder)
    digests = {}
    for path in (path for path in named if path is not None):
        base = (folder / path).parent
        attached = (
            path.parent / os.path.relpath(file, base) for file in files_of_mesh(folder / path)
        )
        for one in (path, *attached):
            digests[str(one)] = hashlib.sha256((folder / one).read_bytes()).hexdigest()
    return digests
